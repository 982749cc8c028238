from esd.datasets.bodies import TESTING_SUBJECTS, bodies
from esd.evaluation.protocol import evaluate
from esd.learning.model import bundled_models, load_model
from esd.learning.presets import PRESETS
from esd.spectral.cache import default_cache


def test_models_are_bundled_for_the_package_s_presets_and_none_saw_the_testing_subjects():
    assert bundled_models() == ("oriented", "paper-gps", "paper-hks", "paper-wks", "partial")
    assert set(bundled_models()) <= set(PRESETS)
    for name in bundled_models():
        seen = {shape.split("_")[0] for shape in load_model(name).card["shapes"]}
        assert seen
        assert not seen & set(TESTING_SUBJECTS)
    assert load_model("default").name == "oriented"


def test_the_default_tells_left_from_right_on_bodies_it_never_saw():
    collection = bodies(vertex_count=2500)
    pairs = [(collection["s10_p01"], collection["s12_p05"])]
    plain, refined = (
        evaluate(load_model("default"), pairs, refine=r, cache=default_cache())[0]
        for r in (False, True)
    )
    assert plain.mean_geodesic_error_x100 < 1.6
    assert plain.mean_geodesic_error_x100 < 1.1 * plain.symmetric_mean_geodesic_error_x100
    assert refined.mean_geodesic_error_x100 < 1.6


def test_embedding_improves_its_descriptor_on_bodies_it_never_saw():
    collection = bodies(vertex_count=2500)
    pairs = [(collection["s10_p01"], collection["s12_p05"])]
    raw, embedded = (
        evaluate(load_model(n), pairs, cache=default_cache())[0] for n in ("hks", "paper-hks")
    )
    assert (
        embedded.symmetric_mean_geodesic_error_x100 < 0.7 * raw.symmetric_mean_geodesic_error_x100
    )
