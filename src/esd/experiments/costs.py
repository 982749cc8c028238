"""What it takes to describe a shape, measured in a fresh process."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from esd.experiments.counting import models_key
from esd.experiments.setting import Setting
from esd.learning.model import Model
from esd.mesh.mesh import Mesh
from esd.spectral.cache import Arrays, content_key


@dataclass(frozen=True, slots=True)
class Cost:
    """Of describing one shape: processor time in seconds, and memory in MB (None: not known)."""

    seconds: float
    megabytes: float | None


def costs_of(setting: Setting, models: Mapping[str, Model]) -> dict[str, Cost]:
    """What each method takes to describe a shape, its spectrum included, in a fresh process."""
    mesh = setting.testing.shapes[0].mesh()
    costs = {}
    with setting.progress("measuring costs", len(models)) as advance:
        for name, model in models.items():

            def compute(model: Model = model) -> Arrays:
                with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
                    seconds, megabytes = fresh.submit(embedding_cost, model, mesh).result()
                return {"seconds": np.array(seconds), "megabytes": np.array(megabytes)}

            key = content_key("cost", mesh.vertices, model=models_key({name: model}))
            found = setting.store.computed(key, compute)
            memory = float(found["megabytes"])
            costs[name] = Cost(float(found["seconds"]), memory if memory > 0 else None)
            advance(1)
    return costs


def embedding_cost(model: Model, mesh: Mesh) -> tuple[float, float]:
    """Processor time in seconds, the less of two, and the largest memory of this process in MB."""
    seconds = []
    for _ in range(2):
        start = time.process_time()
        model.embed_mesh(mesh)
        seconds.append(time.process_time() - start)
    # not by `resource`, where a new process begins with the memory of the one that started it
    status = Path("/proc/self/status")
    if not status.is_file():
        return min(seconds), 0.0  # known on Linux alone
    peak = status.read_text().split("VmHWM:")[1].split()[0]
    return min(seconds), int(peak) / 1000
