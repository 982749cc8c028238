"""Time, memory and accuracy of eigensolvers on the same matrices; prints a table in Markdown.

    python benchmarks/eigensolver.py                              # a bumpy torus, 2.5k to 20k
    python benchmarks/eigensolver.py --sizes 200000 --rounds 1 --methods esd --no-reference
    python benchmarks/eigensolver.py --mesh shape.off --subdivide 0 1 2

Every run is a process of its own, so that its peak memory is its own. The methods take turns,
`--rounds` times (A B C A B C …), and the fastest of the rounds counts. LaPy is run in an
environment of its own, which is made where it is missing.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from measure import add_peers_option, python_of
from scipy import sparse
from scipy.sparse import linalg

REFERENCE = "reference"
METHODS = {
    "eigsh": "`eigsh(L, k, M, sigma=-0.01)` (pyFM)",
    "eigsh-geomfum": "`eigsh(L, k, M, sigma=-1e-8)` (geomfum)",
    "lapy": "LaPy, SuperLU",
    "lapy-cholmod": "LaPy, CHOLMOD",
    "esd": "`esd`",
}


def bumpy_torus(n):
    """A torus of about n vertices without symmetry, as (vertices, faces)."""
    from esd.mesh.mesh import Mesh
    from esd.mesh.shapes import torus

    across = round(np.sqrt(n / 2.5))
    mesh = torus(round(n / across), across)
    vertices = mesh.vertices.copy()
    rng = np.random.default_rng(0)
    for _ in range(12):
        wave, phase, amplitude = 3 * rng.normal(size=3), rng.uniform(0, 6), rng.normal(size=3)
        vertices += 0.06 * amplitude * np.sin(mesh.vertices @ wave + phase)[:, None]
    return Mesh(vertices, mesh.faces)


def write_matrices(mesh, path):
    from esd.spectral.laplacian import lumped_mass, stiffness

    matrix, mass = stiffness(mesh), lumped_mass(mesh)
    np.savez(
        path, data=matrix.data, indices=matrix.indices, indptr=matrix.indptr, mass=mass / mass.sum()
    )


def solve(method, stiffness, mass, k):
    """Eigenvalues and eigenvectors, and what the method says of itself."""
    matrix = sparse.csc_array(sparse.diags_array(mass))
    if method == REFERENCE:  # standard form, a large space, all digits
        root = sparse.diags_array(1 / np.sqrt(mass))
        standard = sparse.csc_array(root @ stiffness @ root)
        values, vectors = linalg.eigsh(standard, k + 10, sigma=-0.01, ncv=2 * k + 60, tol=0)
        return values[:k], (root @ vectors)[:, :k], ""
    if method.startswith("eigsh"):
        sigma = -1e-8 if method == "eigsh-geomfum" else -0.01
        return *linalg.eigsh(stiffness, k, matrix, sigma=sigma), ""
    if method.startswith("lapy"):
        import lapy

        solver = object.__new__(lapy.Solver)  # with our matrices in place of its own
        solver.stiffness, solver.mass = sparse.csc_matrix(stiffness), sparse.csc_matrix(matrix)
        solver.use_cholmod = method == "lapy-cholmod"
        return *solver.eigs(k), ""
    from esd.spectral.eigensolver import eigenpairs

    result = eigenpairs(stiffness, mass, k)
    bound = result.error_bound / result.eigenvalues[-1]
    return (
        result.eigenvalues,
        result.eigenvectors,
        f"{'certified' if result.certified else 'not certified'}, bound {bound:.0e}",
    )


def run_here(method, path, k, output):
    """One measurement, in a process that does nothing else."""
    with np.load(path) as file:
        arrays = (file["data"], file["indices"], file["indptr"])
        mass = file["mass"]
    stiffness = sparse.csc_array(arrays, shape=(len(mass), len(mass)))
    if method.startswith("lapy"):
        import lapy  # noqa: F401 (not to be timed)
    elif method == "esd":
        import esd.spectral.eigensolver  # noqa: F401
    if method == "lapy-cholmod":
        import cholespy  # noqa: F401
    wall, cpu = time.perf_counter(), time.process_time()
    values, vectors, note = solve(method, stiffness, mass, k)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    order = np.argsort(values)
    np.savez(output, values=values[order], vectors=vectors[:, order])
    print(json.dumps({"wall": wall, "cpu": cpu, "memory": peak, "note": note}))


def errors(found, exact):
    """Relative errors of eigenvalues (largest), and of HKS and WKS (largest over their mean)."""
    values, vectors = found
    exact_values, exact_vectors = exact
    eigenvalue = np.max(np.abs(values[1:] / exact_values[1:] - 1))
    times = np.geomspace(4 * np.log(10) / exact_values[-1], 4 * np.log(10) / exact_values[1], 20)
    energies = np.linspace(np.log(exact_values[1]), np.log(exact_values[-1]), 100)
    width = 7 * (energies[1] - energies[0])

    def signatures(values, vectors):
        heat = np.exp(-np.outer(values[1:], times))
        wave = np.exp(-((energies - np.log(values[1:])[:, None]) ** 2) / (2 * width**2))
        return [vectors[:, 1:] ** 2 @ weights for weights in (heat, wave / wave.sum(axis=0))]

    pairs = zip(signatures(values, vectors), signatures(exact_values, exact_vectors), strict=True)
    return [eigenvalue] + [float((abs(a - b).max(axis=0) / b.mean(axis=0)).max()) for a, b in pairs]


def measure(method, path, k, folder, python):
    output = folder / f"{method}.npz"
    command = [python, __file__, "--run", method, str(path), str(k), str(output)]
    source = str(Path(__file__).resolve().parents[1] / "src")
    environment = os.environ | {"PYTHONPATH": source}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    if done.returncode:
        print(f"{method}: {done.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
        return None, None
    with np.load(output) as file:
        result = file["values"], file["vectors"]
    output.unlink()
    return json.loads(done.stdout.splitlines()[-1]), result


def compare(mesh, k, methods, rounds, with_reference):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "matrices.npz"
        write_matrices(mesh, path)
        exact = measure(REFERENCE, path, k, folder, sys.executable)[1] if with_reference else None
        best, accuracy = {}, {}
        for _ in range(rounds):
            for method in methods:
                python = python_of("lapy") if method.startswith("lapy") else sys.executable
                figures, result = measure(method, path, k, folder, python)
                if figures is None:
                    continue
                if method not in best or figures["wall"] < best[method]["wall"]:
                    best[method] = figures
                if exact is not None:
                    accuracy[method] = errors(result, exact)
    base = best.get("eigsh")
    for method in methods:
        if method not in best:
            continue
        figures = best[method]
        ratios = [f"{base[key] / figures[key]:.1f}" if base else "–" for key in ("wall", "cpu")]
        deviation = [f"{error:.0e}" for error in accuracy.get(method, [])] or ["–"] * 3
        cells = [
            str(len(mesh.vertices)),
            METHODS[method],
            f"{figures['wall']:.2f}",
            f"{figures['cpu']:.2f}",
            *ratios,
            f"{figures['memory']:.0f}",
            *deviation,
            figures["note"],
        ]
        print("| " + " | ".join(cells) + " |", flush=True)


def main():
    if sys.argv[1:2] == ["--run"]:
        run_here(sys.argv[2], sys.argv[3], int(sys.argv[4]), sys.argv[5])
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[2500, 5000, 10000, 20000])
    parser.add_argument("--mesh", help="a mesh file in place of the torus")
    parser.add_argument("--subdivide", type=int, nargs="+", default=[0], help="of the mesh file")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("-k", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--no-reference", action="store_true", help="no errors: much less time")
    add_peers_option(parser)
    options = parser.parse_args()
    print(
        "| n | method | wall s | CPU s | × wall | × CPU | peak MB | λ | HKS | WKS | |\n"
        "|--:|:--|--:|--:|--:|--:|--:|--:|--:|--:|:--|",
        flush=True,
    )
    for mesh in meshes(options):
        compare(
            mesh,
            options.k,
            options.methods,
            options.rounds,
            not options.no_reference,
        )


def meshes(options):
    if not options.mesh:
        yield from map(bumpy_torus, options.sizes)
        return
    from esd.mesh.convert import as_mesh
    from esd.mesh.shapes import subdivide

    for times in options.subdivide:
        mesh = as_mesh(options.mesh)
        for _ in range(times):
            mesh = subdivide(mesh)
        yield mesh


if __name__ == "__main__":
    main()
