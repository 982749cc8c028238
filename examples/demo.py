"""Match two people whom the bundled model never saw, measure the map and draw it."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from esd.datasets.bodies import bodies
from esd.evaluation.protocol import evaluate
from esd.learning.model import load_model
from esd.matching.correspondence import save_map
from esd.matching.match import match
from esd.mesh.io.meshes import write_mesh
from esd.spectral.cache import default_cache
from esd.spectral.spectrum import spectrum
from esd.viewing.figures import match_figure, save_figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", default="default")
    parser.add_argument("--output", type=Path, default=Path("demo"))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)

    collection = bodies()
    source, target = collection["s10_p01"], collection["s12_p05"]
    start = time.perf_counter()
    meshes = source.mesh(), target.mesh()
    print(f"two bodies remeshed in {time.perf_counter() - start:.1f} s")

    model = load_model(options.model)
    cache = default_cache()
    start = time.perf_counter()
    for mesh in meshes:
        spectrum(mesh, model.recipe.eigenpairs, kind=model.recipe.laplacian, cache=cache)
    print(f"two spectra of 300 eigenpairs in {time.perf_counter() - start:.1f} s")

    start = time.perf_counter()
    result = match(*meshes, model=model, cache=cache)
    print(f"{len(result.target_index)} vertices matched in {time.perf_counter() - start:.1f} s")

    figures, _ = evaluate(model, [(source, target)], cache=cache)
    print(f"within 5 % of the diameter: {figures.accuracy_5pct_diameter:.1%}")
    print(f"mean geodesic error x 100 / √area: {figures.mean_geodesic_error_x100:.2f}")
    symmetric = figures.symmetric_mean_geodesic_error_x100
    print(f"the same, symmetry-aware: {symmetric:.2f}")

    for shape, mesh in zip((source, target), meshes, strict=True):
        write_mesh(mesh, options.output / f"{shape.name}.ply")
    save_map(result, options.output / "map.csv")
    save_figure(match_figure(*meshes, result), options.output / "match.png")
    print(f"map, meshes and picture are in {options.output}/")


if __name__ == "__main__":
    main()
