"""The studio's server: a page, and what the page asks for."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import shutil
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any, get_args
from urllib.parse import quote

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp

from esd.common import UNFINISHED, InputError, whole_file
from esd.datasets.folder import read_vts
from esd.learning.model import ALIASES, bundled_models
from esd.matching.correspondence import MAP_SUFFIXES, Correspondence, load_map, save_map
from esd.matching.match import Mirror
from esd.mesh.io.fields import FIELD_SUFFIXES, read_labels, write_labels
from esd.mesh.io.landmarks import LANDMARK_FORMATS, Landmarks, read_landmarks, write_landmarks
from esd.mesh.io.meshes import FORMATS, WRITTEN_FORMATS, read_arrays, write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import usable_part
from esd.studio.guard import Guard
from esd.studio.jobs import Job, Jobs
from esd.studio.looks import write_carried_look
from esd.studio.project import Project, ProjectShape, Queued, check_mesh_name
from esd.studio.worker import (
    Carry,
    Examine,
    Match,
    Measure,
    Repair,
    Task,
    as_bytes,
    judgement_of,
)
from esd.viewing.page import MODULES, part, view
from esd.viewing.scene import Scene
from esd.viewing.upright import AXES, default_up, usual_up

LARGEST_MESH = 512 * 2**20
LARGEST_TABLE = 64 * 2**20
LARGEST_OTHER = 4 * 2**20
"""Bytes of what is sent to the studio: meshes, values for each vertex, and all else."""

MIRRORS = get_args(Mirror)
DEFAULTS = {"model": "default", "mirror": "auto"}
"""What is chosen in a new project."""

_OWN = ("studio.js", "landmarks.js", "transfer.js", "gallery.js", "server.js", "studio.css")
_SHOWN_OF_JOBS = ("number", "title", "state", "stage", "share", "error")
_KINDS = {".js": "text/javascript", ".css": "text/css"}
_PATIENCE = 20.0  # seconds after which an unchanged state is sent all the same
_GLANCE = 0.05  # seconds between two looks at the state


class Studio:
    """A project with its jobs, and the answers to the page's requests.

    Parameters
    ----------
    project
        What is shown.
    """

    def __init__(self, project: Project) -> None:
        self.project = project
        self.jobs = Jobs(self._settings()["model"], self._ended)
        for shape in project.shapes():
            if shape.vertices is None:  # the studio was closed before it was examined
                self._examine(shape)
        for path, queued in project.queue():  # when the studio was killed
            try:
                if queued is not None:
                    self._resume(queued)
            except InputError:  # of a shape that was removed
                pass
            path.unlink(missing_ok=True)

    def _resume(self, queued: Queued) -> None:
        numbers = queued.source, queued.target
        if queued.kind == "match":
            self.match(*numbers, landmarks=queued.landmarks)
        elif queued.kind == "measure":
            self.measure(*numbers)
        elif queued.kind == "repair":
            self.repair(queued.source)
        else:
            self.carry(*(self.project.shape(number) for number in numbers))

    def _submit(self, title: str, task: Task, queued: Queued) -> Job:
        """Put a task into the queue, and keep it until it ends."""
        path = self.project.enqueue(queued)
        job: Job | None = None
        try:
            job = self.jobs.submit(title, task, kept=path)
        finally:
            if job is None or job.kept != path:  # refused, or it waits already
                path.unlink(missing_ok=True)
        return job

    def _settings(self) -> dict[str, str]:
        return {**DEFAULTS, **self.project.settings()}

    def _examine(self, shape: ProjectShape) -> Job:
        task = Examine(
            self.project.path(shape),
            shape.name,
            self.project.view_path(shape.number),
            self._settings()["model"],
        )
        return self.jobs.submit(f"Examine {shape.name}", task)

    def add_file(self, path: Path, name: str) -> ProjectShape:
        """Add the shape in a file, which is moved, and have it examined."""
        shape = self.project.add(name, path)
        self._examine(shape)
        return shape

    def match(self, source: int, target: int, *, landmarks: bool) -> Job:
        """Have a pair matched with the model and options that are chosen.

        Raises
        ------
        InputError
            If there are no such shapes, or fewer than three landmarks that both have.
        """
        shapes = self.project.shape(source), self.project.shape(target)
        if source == target:
            raise InputError("Choose two different shapes.")
        if landmarks and len(set(shapes[0].names) & set(shapes[1].names)) < 3:
            raise InputError("Three landmarks or more must be on both shapes.")
        chosen = self._settings()
        task = self._match(*shapes, chosen["model"], chosen["mirror"])
        if landmarks:
            # whether the source is a mirror image was found out when the map was not wrong
            settled = self._figures(source, target).get("verdict") in ("good", "doubtful")
            if settled and chosen["mirror"] == "auto":
                before = self._figures(source, target)["judgement"]["is_mirrored"]
                task = replace(task, mirror="yes" if before else "no")
            task = replace(task, landmarks=(shapes[0].landmarks(), shapes[1].landmarks()))
        return self._submit(
            f"Match {shapes[0].name} to {shapes[1].name}",
            task,
            Queued("match", source, target, landmarks),
        )

    def _match(self, source: ProjectShape, target: ProjectShape, model: str, mirror: str) -> Match:
        return Match(
            self.project.path(source),
            self.project.path(target),
            (source.name, target.name),
            self.project.map_path(source.number, target.number),
            self.project.map_path(source.number, target.number, ".json"),
            self.project.view_path(source.number, target.number),
            model,
            mirror,
        )

    def _figures(self, source: int, target: int) -> dict[str, Any]:
        """The figures of the map of a pair; none if there is no map."""
        for figures in self.project.maps():
            if (figures["source"], figures["target"]) == (source, target):
                return figures
        return {}

    def measure(self, source: int, target: int) -> Job | None:
        """Have the error of a map measured, if the truth is known and there is a map."""
        truth = self.project.truth_path(source, target)
        points = self.project.points_path(source), self.project.points_path(target)
        is_known = truth.is_file() or all(path.is_file() for path in points)
        figures = self._figures(source, target)
        if not is_known or not figures:
            return None
        shapes = self.project.shape(source), self.project.shape(target)
        found = self._match(*shapes, figures["model"], figures["mirror"])
        task = Measure(found, truth, None) if truth.is_file() else Measure(found, None, points)
        return self._submit(
            f"Measure {shapes[0].name} to {shapes[1].name}", task, Queued("measure", source, target)
        )

    def repair(self, number: int) -> Job:
        """Have a repaired copy of a shape added."""
        shape = self.project.shape(number)
        output = self.project.folder / "meshes" / f"repaired-{number}.ply"
        task = Repair(self.project.path(shape), output)
        return self._submit(f"Repair {shape.name}", task, Queued("repair", number, number))

    def carry(self, source: ProjectShape, target: ProjectShape) -> Job | None:
        """Have the labels and the texture or colours of the source carried; None if it has none."""
        numbers = source.number, target.number
        task = Carry(
            self.project.path(source), self.project.path(target), self.project.map_path(*numbers)
        )
        if source.labels:
            labels = (
                self.project.labels_path(source.number),
                self.project.labels_path(target.number),
            )
            task = replace(task, labels=labels)
        if source.look:
            task = replace(task, look=(source.look, self.project.carried_path(*numbers)))
        if task.labels is None and task.look is None:
            return None
        return self._submit(
            f"Carry from {source.name} to {target.name}", task, Queued("carry", *numbers)
        )

    def _ended(self, job: Job, result: dict[str, Any] | None) -> None:
        """Keep what a job found out; a shape that cannot be used is removed."""
        try:
            self._keep(job, result)
        finally:
            if job.kept is not None:
                job.kept.unlink(missing_ok=True)
        self.jobs.touch()

    def _keep(self, job: Job, result: dict[str, Any] | None) -> None:
        task = job.task
        if isinstance(task, Examine):
            for shape in self.project.shapes():
                if self.project.path(shape) == task.path and shape.vertices is None:
                    if result is not None:
                        self.project.examined(shape.number, **result)
                    else:
                        self.project.remove(shape.number)
        elif isinstance(task, Repair) and result is not None:
            name = next(
                (s.name for s in self.project.shapes() if self.project.path(s) == task.path), ""
            )
            stem = name.split(".")[0] or "mesh"
            self.add_file(task.output, f"{stem}-repaired{task.output.suffix}")
        elif isinstance(task, Match) and result is not None:
            self.measure(*(int(number) for number in task.map.stem.split("-")))
        elif isinstance(task, Carry) and result is not None and task.labels is not None:
            self.project.given(int(task.labels[1].stem), "labels")

    def state(self) -> dict[str, Any]:
        """All that the page shows but the shapes and maps themselves."""
        version = self.jobs.version  # first: whatever changes from here on is asked for again
        jobs = self.jobs.list()  # then what those that ended found is in the rest
        return {
            "version": version,
            "folder": str(self.project.folder.resolve()),
            "shapes": [
                {key: value for key, value in asdict(shape).items() if key != "file"}
                for shape in self.project.shapes()
            ],
            "maps": [
                {key: value for key, value in figures.items() if key != "judgement"}
                for figures in self.project.maps()
            ],
            "jobs": [{key: getattr(job, key) for key in _SHOWN_OF_JOBS} for job in jobs],
            "settings": self._settings(),
            "models": [*ALIASES, *bundled_models()],
            "formats": list(FORMATS),
        }

    # what the page asks for

    async def get_state(self, request: Request) -> Response:
        """All that the page shows, at once or when it is no longer what the page knows."""
        after = request.query_params.get("after")
        end = time.monotonic() + _PATIENCE
        while after == str(self.jobs.version) and time.monotonic() < end:
            await asyncio.sleep(_GLANCE)
        return JSONResponse(await run_in_threadpool(self.state))

    async def add_shape(self, request: Request) -> Response:
        """Take a mesh file in."""
        name = check_mesh_name(request.query_params.get("name", ""))
        path = await _received(request, self.project.folder, LARGEST_MESH)
        try:
            shape = await run_in_threadpool(self.add_file, path, name)
        finally:
            path.unlink(missing_ok=True)
        return JSONResponse({"number": shape.number, "version": self.jobs.version}, 201)

    async def remove_shape(self, request: Request) -> Response:
        """Remove a shape with its maps."""
        await run_in_threadpool(self.project.remove, request.path_params["number"])
        return self._changed()

    async def repair_shape(self, request: Request) -> Response:
        """Have a repaired copy of a shape added."""
        job = await run_in_threadpool(self.repair, request.path_params["number"])
        return JSONResponse({"job": job.number}, 202)

    async def get_shape(self, request: Request) -> Response:
        """What the viewer shows of a shape."""
        return await _file(self.project.view_path(request.path_params["number"]))

    async def set_landmarks(self, request: Request) -> Response:
        """Replace the landmarks of a shape."""
        given = await _json(request)
        names, places = given.get("names"), given.get("places")
        if not isinstance(names, list) or not isinstance(places, list):
            raise InputError("Expected lists of names and of places.")
        number = request.path_params["number"]
        await run_in_threadpool(self.project.set_landmarks, number, names, places)
        return self._changed()

    async def load_landmarks(self, request: Request) -> Response:
        """Replace the landmarks of a shape by those in a file."""
        suffix = _suffix(request.query_params.get("name", ""), LANDMARK_FORMATS)
        shape = self.project.shape(request.path_params["number"])
        content = await _body(request, LARGEST_OTHER)
        read = await run_in_threadpool(self._read_landmarks, shape, suffix, content)
        kept = [(n, int(v)) for n, v in zip(read.names, read.vertices, strict=True) if v >= 0]
        names, places = [list(column) for column in zip(*kept, strict=True)] if kept else ([], [])
        await run_in_threadpool(self.project.set_landmarks, shape.number, names, places)
        return self._changed()

    def _read_landmarks(self, shape: ProjectShape, suffix: str, content: bytes) -> Landmarks:
        with _as_file(content, f"landmarks{suffix}") as path:
            return read_landmarks(path, self._mesh(shape))

    async def save_landmarks(self, request: Request) -> Response:
        """The landmarks of a shape as a file."""
        suffix = _suffix(request.query_params.get("format", ".csv"), LANDMARK_FORMATS)
        shape = self.project.shape(request.path_params["number"])
        stem = shape.name.split(".")[0]
        return await self._written(
            f"{stem}-landmarks{suffix}",
            lambda path: write_landmarks(shape.landmarks(), self._mesh(shape), path),
        )

    async def carry_landmarks(self, request: Request) -> Response:
        """Give the target the landmarks of the source that it lacks, along their map."""
        source, target = self._pair(request)
        await run_in_threadpool(self._carry, source, target)
        return self._changed()

    def _carry(self, source: ProjectShape, target: ProjectShape) -> None:
        index = self._map(source, target).target_index
        places = dict(zip(target.names, target.places, strict=True))
        for name, place in zip(source.names, source.places, strict=True):
            if index[place] >= 0:
                places.setdefault(name, int(index[place]))
        self.project.set_landmarks(target.number, list(places), list(places.values()))

    async def carry_data(self, request: Request) -> Response:
        """Carry landmarks, labels and a texture or colours from the source to the target."""
        source, target = self._pair(request)
        await run_in_threadpool(self._carry, source, target)
        job = self.carry(source, target)
        self.jobs.touch()
        return JSONResponse({"job": job.number if job else None}, 202)

    async def set_up(self, request: Request) -> Response:
        """Keep which axis of a shape points up."""
        axis = (await _json(request)).get("up")
        if axis not in AXES:
            raise InputError(f"Expected one of {', '.join(AXES)}.")
        await run_in_threadpool(self.project.set_up, request.path_params["number"], axis)
        return self._changed()

    async def load_labels(self, request: Request) -> Response:
        """Replace the labels of the vertices or faces of a shape by those in a file."""
        suffix = _suffix(request.query_params.get("name", ""), FIELD_SUFFIXES)
        shape = self.project.shape(request.path_params["number"])
        content = await _body(request, LARGEST_TABLE)
        await run_in_threadpool(self._load_labels, shape, suffix, content)
        return self._changed()

    def _load_labels(self, shape: ProjectShape, suffix: str, content: bytes) -> None:
        with _as_file(content, f"labels{suffix}") as path:
            labels, names = read_labels(path)
        if len(labels) not in (shape.vertices, shape.faces):
            raise InputError(
                f"Expected a label for each of {shape.vertices} vertices or {shape.faces} faces; "
                f"got {len(labels)}."
            )
        write_labels(labels, self.project.labels_path(shape.number), names)
        self.project.given(shape.number, "labels")

    async def save_labels(self, request: Request) -> Response:
        """The labels of a shape as a file."""
        shape = self.project.shape(request.path_params["number"])
        path = self.project.labels_path(shape.number)
        if not path.is_file():
            raise HTTPException(404, "This shape has no labels.")
        name = f"{shape.name.split('.')[0]}-labels.txt"
        return await self._written(name, lambda copy: shutil.copyfile(path, copy))

    async def get_labels(self, request: Request) -> Response:
        """What the viewer shows of the labels of a shape."""
        shape = self.project.shape(request.path_params["number"])
        content = await run_in_threadpool(self._shown_labels, shape)
        return Response(content, media_type="application/octet-stream")

    def _shown_labels(self, shape: ProjectShape) -> bytes:
        path = self.project.labels_path(shape.number)
        if not path.is_file():
            raise HTTPException(404, "This shape has no labels.")
        labels, names = read_labels(path)
        if len(labels) != shape.vertices:  # of faces: each vertex has that of one of its own
            of_faces, labels = labels, np.full(shape.vertices or 0, -1)
            labels[read_arrays(self.project.path(shape))[1]] = of_faces[:, None]
        return as_bytes(Scene({"names": names}, {"labels": labels.astype("<i4")}))

    async def load_points(self, request: Request) -> Response:
        """Take the vertices of a shape at the points of a template, by which maps are measured."""
        _suffix(request.query_params.get("name", ""), (".vts",))
        shape = self.project.shape(request.path_params["number"])
        content = await _body(request, LARGEST_TABLE)
        await run_in_threadpool(self._load_points, shape, content)
        return self._changed()

    def _load_points(self, shape: ProjectShape, content: bytes) -> None:
        with _as_file(content, "points.vts") as path:
            points = read_vts(path)
        if len(points) == 0 or points.max() >= (shape.vertices or 0):
            raise InputError(f"Points are vertices from 1 to {shape.vertices}, one a line.")
        with whole_file(self.project.points_path(shape.number)) as temporary:
            temporary.write_bytes(content)
        self.project.given(shape.number, "points")
        for figures in self.project.maps():
            if shape.number in (figures["source"], figures["target"]):
                self.measure(figures["source"], figures["target"])

    async def load_truth(self, request: Request) -> Response:
        """Take the true map of a pair, and have the error of its map measured."""
        source, target = self._pair(request)
        suffix = _suffix(request.query_params.get("name", ""), MAP_SUFFIXES)
        content = await _body(request, LARGEST_TABLE)
        await run_in_threadpool(self._load_truth, source, target, suffix, content)
        return self._changed()

    def _load_truth(
        self, source: ProjectShape, target: ProjectShape, suffix: str, content: bytes
    ) -> None:
        with _as_file(content, f"truth{suffix}") as path:
            truth = load_map(path, source_count=source.vertices, target_count=target.vertices)
        save_map(truth, self.project.truth_path(source.number, target.number))
        self.measure(source.number, target.number)

    async def start_match(self, request: Request) -> Response:
        """Have a pair matched."""
        given = await _json(request)
        source, target = given.get("source"), given.get("target")
        if not isinstance(source, int) or not isinstance(target, int):
            raise InputError("Expected the numbers of a source and a target.")
        job = await run_in_threadpool(
            self.match, source, target, landmarks=bool(given.get("landmarks"))
        )
        return JSONResponse({"job": job.number}, 202)

    async def cancel_job(self, request: Request) -> Response:
        """Cancel a job."""
        self.jobs.cancel(request.path_params["number"])
        return self._changed()

    async def set_settings(self, request: Request) -> Response:
        """Keep the model and the options that are chosen."""
        given = {**DEFAULTS, **await _json(request)}
        models = (*ALIASES, *bundled_models())
        if given["model"] not in models or given["mirror"] not in MIRRORS:
            raise InputError(f"Expected a model among {', '.join(models)}; mirror auto, yes or no.")
        chosen = {key: str(given[key]) for key in DEFAULTS}
        await run_in_threadpool(self.project.set_settings, chosen)
        return self._changed()

    async def get_map(self, request: Request) -> Response:
        """What the viewer shows of a map."""
        source, target = self._pair(request)
        return await _file(self.project.view_path(source.number, target.number))

    async def export(self, request: Request) -> Response:
        """A map, the source in the shape of the target, a page, or the target with the texture."""
        source, target = self._pair(request)
        kind = request.path_params["kind"]
        wanted = request.query_params.get("format", "")
        stem = f"{source.name.split('.')[0]}-{target.name.split('.')[0]}"
        if kind == "map":
            suffix = _suffix(wanted or ".csv", MAP_SUFFIXES)
            return await self._written(
                stem + suffix, lambda path: save_map(self._map(source, target), path)
            )
        if kind == "mesh":
            suffix = _suffix(wanted or ".ply", WRITTEN_FORMATS)
            return await self._written(
                f"{stem}{suffix}", lambda path: write_mesh(self._image(source, target), path)
            )
        if kind == "look":
            return await self._written(
                f"{stem}.glb",
                lambda path: write_carried_look(
                    self.project.path(source),
                    self._mesh(target),
                    self._map(source, target),
                    source.look,
                    path,
                ),
            )
        if kind != "page":
            raise HTTPException(404, "There is nothing of that kind.")
        return await self._written(
            f"{stem}.html", lambda path: self._write_page(source, target, path)
        )

    def _map(self, source: ProjectShape, target: ProjectShape) -> Correspondence:
        found = load_map(self.project.map_path(source.number, target.number))
        return replace(found, judgement=judgement_of(self._figures(source.number, target.number)))

    def _mesh(self, shape: ProjectShape) -> Mesh:
        return usable_part(self.project.path(shape))

    def _image(self, source: ProjectShape, target: ProjectShape) -> Mesh:
        """The source's triangles where the map puts them on the target.

        Triangles with a corner that has no counterpart are left out.
        """
        index, mesh = self._map(source, target).target_index, self._mesh(source)
        whole = (index[mesh.faces] >= 0).all(axis=1)
        return Mesh(self._mesh(target).vertices[np.maximum(index, 0)], mesh.faces[whole])

    def _write_page(self, source: ProjectShape, target: ProjectShape, path: Path) -> None:
        mesh = self._mesh(source)
        view(
            mesh,
            self._mesh(target),
            self._map(source, target),
            source_name=source.name,
            target_name=target.name,
            model=self._figures(source.number, target.number)["model"],
            up=source.up or default_up(mesh, usual=usual_up(self.project.path(source))),
        ).save(path)

    def _pair(self, request: Request) -> tuple[ProjectShape, ProjectShape]:
        source, target = (
            self.project.shape(request.path_params[key]) for key in ("source", "target")
        )
        if not self.project.map_path(source.number, target.number).is_file():
            raise HTTPException(404, "These shapes have not been matched yet.")
        return source, target

    async def _written(self, name: str, write: Callable[[Path], Any]) -> Response:
        """What a function writes to a file, to be saved under a name."""

        def content() -> bytes:
            with tempfile.TemporaryDirectory(prefix="esd-") as folder:
                path = Path(folder) / f"file{_ending(name)}"
                write(path)
                return path.read_bytes()

        disposition = f"attachment; filename*=UTF-8''{quote(name, safe='')}"
        return Response(
            await run_in_threadpool(content),
            media_type="application/octet-stream",
            headers={"Content-Disposition": disposition},
        )

    def _changed(self) -> Response:
        self.jobs.touch()
        return JSONResponse({"version": self.jobs.version})


def create_app(studio: Studio, *, token: str, port: int) -> ASGIApp:
    """The studio as an application that a server runs; its page is at `/TOKEN/`.

    Parameters
    ----------
    studio
        Which answers; whoever runs the application closes its jobs.
    token
        Without which nothing is answered.
    port
        Where the server listens; requests by other names are refused.
    """
    page, policy = _page()

    async def get_page(request: Request) -> Response:
        return HTMLResponse(page)

    pair = "/maps/{source:int}/{target:int}"
    routes = [
        Route("/", get_page),
        Route("/static/{name}", _static),
        Route("/state", studio.get_state),
        Route("/settings", studio.set_settings, methods=["PUT"]),
        Route("/shapes", studio.add_shape, methods=["POST"]),
        Route("/shapes/{number:int}", studio.remove_shape, methods=["DELETE"]),
        Route("/shapes/{number:int}/view", studio.get_shape),
        Route("/shapes/{number:int}/repair", studio.repair_shape, methods=["POST"]),
        Route("/shapes/{number:int}/landmarks", studio.save_landmarks),
        Route("/shapes/{number:int}/landmarks", studio.set_landmarks, methods=["PUT"]),
        Route("/shapes/{number:int}/landmarks", studio.load_landmarks, methods=["POST"]),
        Route("/matches", studio.start_match, methods=["POST"]),
        Route("/shapes/{number:int}/up", studio.set_up, methods=["PUT"]),
        Route("/shapes/{number:int}/labels", studio.save_labels),
        Route("/shapes/{number:int}/labels", studio.load_labels, methods=["POST"]),
        Route("/shapes/{number:int}/labels/view", studio.get_labels),
        Route("/shapes/{number:int}/points", studio.load_points, methods=["POST"]),
        Route(f"{pair}/view", studio.get_map),
        Route(f"{pair}/landmarks", studio.carry_landmarks, methods=["POST"]),
        Route(f"{pair}/carry", studio.carry_data, methods=["POST"]),
        Route(f"{pair}/truth", studio.load_truth, methods=["POST"]),
        Route(pair + "/{kind:str}", studio.export),
        Route("/jobs/{number:int}", studio.cancel_job, methods=["DELETE"]),
    ]

    app = Starlette(
        routes=routes,
        exception_handlers={InputError: _refused, HTTPException: _failed, OSError: _unwritten},  # type: ignore[dict-item]
    )
    return Guard(app, token=token, port=port, policy=policy)


def _page() -> tuple[str, str]:
    """The page, and a content security policy under which it works and nothing else does."""
    addresses = {f"esd/{name}": f"./static/{name}" for name in (*MODULES, *_OWN)}
    modules = json.dumps({"imports": {k: v for k, v in addresses.items() if k.endswith(".js")}})
    page = Template(_own_part("studio.html")).substitute(
        modules=modules, stage=part("stage.html"), panel=part("panel.html")
    )
    digest = base64.b64encode(hashlib.sha256(modules.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; script-src 'self' 'sha256-{digest}'; style-src 'self'; "
        "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'self'; "
        "frame-ancestors 'none'"
    )
    return page, policy


def _own_part(name: str) -> str:
    return (resources.files("esd.studio") / "page" / name).read_text(encoding="utf-8")


async def _static(request: Request) -> Response:
    name = request.path_params["name"]
    if name in (*MODULES, "viewer.css", "three.min.js"):
        text = part(name)
    elif name in _OWN:
        text = _own_part(name)
    else:
        raise HTTPException(404, "There is no such file.")
    return Response(text, media_type=_KINDS[_ending(name)])


async def _refused(_: Request, error: Exception) -> Response:
    return JSONResponse({"error": " ".join(str(error).split())}, 400)


async def _failed(_: Request, error: HTTPException) -> Response:
    return JSONResponse({"error": error.detail}, error.status_code)


async def _unwritten(_: Request, error: OSError) -> Response:
    return JSONResponse({"error": f"It cannot be written: {error.strerror or error}."}, 507)


def _ending(name: str) -> str:
    """The end of a name from its last dot on, with that before `.json`."""
    for suffix in LANDMARK_FORMATS:
        if name.endswith(suffix):
            return suffix
    return Path(name).suffix


@contextmanager
def _as_file(content: bytes, name: str) -> Iterator[Path]:
    """A file with some content, whose errors name it without its folder."""
    with tempfile.TemporaryDirectory(prefix="esd-") as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        try:
            yield path
        except InputError as error:
            raise InputError(str(error).replace(str(path), path.name)) from error


def _suffix(name: str, known: Any) -> str:
    for suffix in known:
        if name.lower().endswith(suffix):
            return str(suffix)
    raise InputError(f"Expected a name that ends in one of {', '.join(known)}.")


async def _file(path: Path) -> Response:
    try:  # whole, since its shape may be removed while it is sent
        content = await run_in_threadpool(path.read_bytes)
    except FileNotFoundError as error:
        raise HTTPException(404, "There is nothing to show yet.") from error
    return Response(content, media_type="application/octet-stream")


async def _body(request: Request, limit: int) -> bytes:
    content = bytearray()
    async for chunk in _chunks(request, limit):
        content += chunk
    return bytes(content)


async def _json(request: Request) -> dict[str, Any]:
    try:
        given = json.loads(await _body(request, LARGEST_OTHER))
    except (ValueError, RecursionError) as error:
        raise InputError("Expected JSON.") from error
    if not isinstance(given, dict):
        raise InputError("Expected a JSON object.")
    return given


async def _received(request: Request, folder: Path, limit: int) -> Path:
    """A temporary file in a folder with what a request brings; no more than it may."""
    handle = tempfile.NamedTemporaryFile(dir=folder, prefix=UNFINISHED, delete=False)  # noqa: SIM115
    path = Path(handle.name)
    try:
        with handle:
            async for chunk in _chunks(request, limit):
                handle.write(chunk)
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    return path


async def _chunks(request: Request, limit: int) -> AsyncIterator[bytes]:
    too_large = HTTPException(413, f"It is larger than {limit // 2**20} MiB.")
    announced = request.headers.get("content-length", "0")
    if not announced.isdigit() or int(announced) > limit:
        raise too_large
    size = 0
    try:
        async for chunk in request.stream():
            size += len(chunk)
            if size > limit:
                raise too_large
            yield chunk
    except ClientDisconnect as error:
        raise HTTPException(400, "The upload was broken off.") from error
