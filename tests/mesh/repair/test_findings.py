from damaged import COUNT, SPHERE, soup
from esd.mesh.repair.diagnose import diagnose


def test_findings_say_how_many_how_bad_and_what_to_do():
    finding = diagnose(soup(SPHERE)).findings[0]
    assert finding.what == f"{3 * len(SPHERE.faces) - COUNT} vertices doubled along seams"
    assert finding.severity == "serious"
    assert "torn" in finding.effect
    assert "joined" in finding.remedy
    assert finding.always_repaired
    assert diagnose(soup(SPHERE)).severity == "serious"
