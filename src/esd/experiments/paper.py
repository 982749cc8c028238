"""The paper's own figures, all on Dyna, to be shown beside ours and never as ours."""

from __future__ import annotations

from esd.experiments.report import Table

TABLE1 = Table(
    "paper_table1",
    "The paper's table 1: correct matches among the 6,890 vertices of Dyna's meshes",
    ("source", "target", "GPS", "HKS", "WKS", "EGPS", "EHKS", "EWKS"),
    (
        (r"50002_one_leg_jump\00455", r"50027_jumping_jacks\00228", 0, 211, 669, 631, 1585, 706),
        (
            r"50009_running_on_spot\00165",
            r"50004_punching\00170",
            147,
            2209,
            2124,
            2374,
            2300,
            1325,
        ),
        (
            r"50020_chicken_wings\00090",
            r"50022_one_leg_jump\00266",
            84,
            1145,
            1328,
            3478,
            2654,
            1595,
        ),
        (r"50026_light_hopping_loose\00168", r"50020_knees\00374", 25, 627, 1072, 1072, 2229, 1794),
        (r"50007_jiggle_on_toes\00233", r"50022_shake_arms\00302", 206, 455, 1162, 998, 1637, 1684),
        (r"50002_hips\00515", r"50007_shake_shoulders\00214", 17, 1474, 1943, 921, 1975, 1565),
    ),
)
"""Correct matches after both rejections, for each descriptor and its embedding."""

TABLE1_POINTS = 6890
"""Vertices of a mesh of Dyna, of which table 1 counts some."""

TABLE2 = Table(
    "paper_table2",
    "The paper's table 2, on Dyna: mean share of correct matches in percent, and RSD",
    (
        "group",
        "subjects",
        *(
            f"{name} {what}"
            for name in ("HKS", "OSD", "GCNN", "ACNN", "EHKS")
            for what in ("%", "RSD")
        ),
    ),
    (
        (1, r"50020\50020", 54.18, 0.15, 42.84, 0.22, 15.69, 0.16, 26.46, 0.10, 34.73, 0.05),
        (2, r"50020\50021", 10.71, 0.20, 20.13, 0.18, 20.76, 0.21, 33.03, 0.11, 28.91, 0.08),
        (3, r"50020\50025", 5.88, 0.28, 17.18, 0.14, 22.25, 0.17, 31.93, 0.09, 26.15, 0.08),
        (4, r"50020\50002", 0.12, 0.53, 1.80, 0.27, 0.54, 0.52, 1.05, 0.28, 10.12, 0.10),
    ),
)
"""Matches within 5 % of the diameter among 10 % of the vertices, over ten pairs a group."""
