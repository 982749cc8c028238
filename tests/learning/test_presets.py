from esd.learning.presets import PRESETS


def test_presets_have_the_paper_s_layers():
    paper = {name: t for name, t in PRESETS.items() if name.startswith("paper")}
    assert {name: (t.recipe.width, *t.hidden, t.outputs) for name, t in paper.items()} == {
        "paper-hks": (100, 78, 32, 15),
        "paper-wks": (100, 78, 32, 15),
        "paper-gps": (25, 20, 18, 15),
    }
