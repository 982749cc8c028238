from esd.descriptors.recipe import single_recipe
from esd.learning.presets import PRESETS


def test_presets_have_the_paper_s_layers():
    paper = {name: t for name, t in PRESETS.items() if name.startswith("paper")}
    assert {name: (t.recipe.width, *t.hidden, t.outputs) for name, t in paper.items()} == {
        "paper-hks": (100, 78, 32, 15),
        "paper-wks": (100, 78, 32, 15),
        "paper-gps": (25, 20, 18, 15),
    }


def test_presets_of_the_comparison_take_hks_and_give_16_dimensions():
    for name in ("gcnn", "acnn"):
        training = PRESETS[name]
        assert training.recipe == PRESETS["paper-hks"].recipe
        assert training.outputs == 16
        assert training.patches is not None
        assert training.patches.bins[0] == 5
        assert training.patches.bins[1] == 16


def test_the_presets_are_those_of_the_paper_and_of_the_authors():
    assert PRESETS["osd"].recipe == single_recipe("hks")
    geometry = PRESETS["osd-geometry"]
    assert (geometry.recipe.eigenpairs, geometry.recipe.width, geometry.outputs) == (300, 150, 16)
