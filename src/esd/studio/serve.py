"""Run the studio on this machine alone."""

from __future__ import annotations

import secrets
import shutil
import signal
import socket
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import uvicorn

from esd.common import UNFINISHED, InputError
from esd.studio.app import Studio, create_app
from esd.studio.project import Project, check_mesh_name

_ADDRESS = "127.0.0.1"


def new_project_folder(parent: Path) -> Path:
    """The first of `studio`, `studio-2`, `studio-3`, … that does not exist in a folder."""
    number = 1
    while (folder := parent / ("studio" if number == 1 else f"studio-{number}")).exists():
        number += 1
    return folder


def serve(
    folder: Path,
    *,
    shapes: Sequence[Path] = (),
    port: int = 0,
    on_start: Callable[[str], None] = lambda _: None,
) -> None:
    """Serve the project in a folder until the process is interrupted.

    Parameters
    ----------
    shapes
        Mesh files that are copied into the project; two are matched at once.
    port
        Where to listen; 0 for any that is free.
    on_start
        Called with the address, which holds a new token.

    Raises
    ------
    InputError
        If the folder cannot be used, a shape is no mesh file, or the port is taken.
    """
    for shape in shapes:
        check_mesh_name(shape.name)
        if not shape.is_file():
            raise InputError(f"There is no file '{shape}'.")
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((_ADDRESS, port))
    except OSError as error:
        listener.close()
        raise InputError(
            f"Port {port} cannot be used: {error.strerror}; give another one, or none."
        ) from error
    try:
        project = Project(folder)
    except InputError:
        listener.close()
        raise
    port = listener.getsockname()[1]
    token = secrets.token_urlsafe(24)
    studio = Studio(project)
    app = create_app(studio, token=token, port=port)
    try:
        numbers = []
        for shape in shapes:
            with tempfile.NamedTemporaryFile(dir=folder, prefix=UNFINISHED, delete=False) as copy:
                path = Path(copy.name)
            shutil.copyfile(shape, path)
            numbers.append(studio.add_file(path, shape.name).number)
        if len(numbers) == 2:
            studio.match(*numbers, landmarks=False)
        listener.listen()  # a browser that is quicker than the server waits
        config = uvicorn.Config(
            app,
            lifespan="off",
            log_level="error",
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=1,
        )
        server = uvicorn.Server(config)

        def end(*_: object) -> None:
            server.should_exit = True

        is_main = threading.current_thread() is threading.main_thread()
        # also for a Ctrl-C while the server starts, when it does not listen to signals yet
        before = signal.signal(signal.SIGINT, end) if is_main else None
        try:
            on_start(f"http://{_ADDRESS}:{port}/{token}/")
            server.run(sockets=[listener])
        finally:
            if is_main:
                signal.signal(signal.SIGINT, before)
    finally:
        studio.jobs.close()
