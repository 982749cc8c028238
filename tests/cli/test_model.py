import pytest

from esd.learning.model import bundled_models, load_model


def test_models_and_raw_descriptors_are_listed(run_here, tmp_path):
    listed = run_here("model", "list", where=tmp_path).stdout.splitlines()
    assert "oriented (default)" in listed
    assert "hks (raw descriptor)" in listed


@pytest.mark.parametrize("name", bundled_models())
def test_what_a_model_is_made_of_takes_three_lines(run_here, tmp_path, name):
    shown = run_here("model", "show", name, where=tmp_path).stdout.splitlines()
    assert shown[0] == f"# {name}"
    heads = [line.partition(":")[0] for line in shown if line.startswith("- ")]
    assert heads[:3] == [
        "- Descriptors",
        "- Layers" if load_model(name).layers else "- Network",
        "- Training",
    ]
    others = ("- On ", "- Trained by a prototype", "- The network beside the layers")
    assert all(head.startswith(others) for head in heads[3:])
    assert max(map(len, shown)) < 250  # the names of hundred shapes are not listed
