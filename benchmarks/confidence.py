"""Whether the confidence of a match is the share of such matches that are right.

    python benchmarks/confidence.py MODEL DATASET 'tr_reg_06[0-4],tr_reg_07[0-4]'

Matches of pairs of different subjects, by their confidence: how many there are, their mean
confidence, and the share within 5 % of the geodesic diameter of the truth, which should equal it.
Then each verdict, how often it was given, and the same for its maps.
"""

from __future__ import annotations

import argparse

from measure import row, table

from esd.datasets.open import open_collection
from esd.evaluation.protocol import evaluate
from esd.learning.model import load_model
from esd.spectral.cache import default_cache


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model")
    parser.add_argument("dataset")
    parser.add_argument("include")
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--rotate", type=int, help="seed by which shapes are rotated at random")
    options = parser.parse_args()
    every = open_collection(options.dataset).including(options.include).pairs()
    pairs = every[:: max(1, len(every) // options.pairs)][: options.pairs]
    result, _ = evaluate(
        load_model(options.model), pairs, rotate=options.rotate, cache=default_cache()
    )
    table("confidence", "share of the matches", "mean confidence", "right")
    for each in result.confidence_bins:
        cells = (f"{each.share:.1%}", f"{each.confidence:.2f}", f"{each.right:.2f}")
        row(f"{each.low:g} to {each.high:g}", *cells)
    sums = [
        sum(each.share * value(each) for each in result.confidence_bins)
        for value in (lambda each: each.confidence, lambda each: each.right)
    ]
    row("all", "100.0%", *(f"{value:.3f}" for value in sums))
    print()
    table("verdict", "maps", "expected", "right", "least right")
    for verdict, each in result.verdicts.items():
        shares = (each.expected, each.right, each.least_right)
        row(verdict, each.maps, *(f"{share:.3f}" for share in shares))


if __name__ == "__main__":
    main()
