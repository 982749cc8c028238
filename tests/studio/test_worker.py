import json
from dataclasses import asdict

from esd.matching.confidence import Adaptation, Judgement, Overlap
from esd.mesh.io.meshes import write_mesh
from esd.mesh.shapes import torus
from esd.studio.worker import Examine, _Memory, done, judgement_of


def test_a_task_reports_how_far_it_is(tmp_path):
    write_mesh(torus(32, 16), tmp_path / "a.off")
    reported = []
    task = Examine(tmp_path / "a.off", "a.off", tmp_path / "a.bin", "hks")
    done(task, _Memory(), lambda *how_far: reported.append(how_far))
    stages, shares = zip(*reported, strict=True)
    assert stages == ("Reading", "Looking for defects", "Computing spectrum and descriptors")
    assert shares[0] == 0
    assert list(shares) == sorted(set(shares))
    assert shares[-1] < 1


def test_a_judgement_is_the_same_after_its_file():
    adaptation = Adaptation(seconds=3.0, cost_before=1.0, cost_after=0.5, is_kept=True)
    overlap = Overlap(source=0.4, scale=1.0, consistent=0.9)
    for parts in ({}, {"overlap": overlap}, {"adaptation": adaptation, "overlap": overlap}):
        judged = Judgement(
            "doubtful", 0.8, 0.9, {"embedding": 1.0}, contradicted=(1, 3), not_repaired="a", **parts
        )
        figures = json.loads(json.dumps({"judgement": asdict(judged)}))
        again = judgement_of(figures)
        assert again == judged
        assert again.advice == judged.advice
    assert judgement_of({"judgement": None}) is None
    assert judgement_of({}) is None
