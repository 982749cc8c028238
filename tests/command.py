"""The command line in a process of its own."""

import os
import subprocess
import sys


def run(*arguments: object, expect: int = 0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "esd", *map(str, arguments)]
    wide = {**os.environ, "COLUMNS": "200"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=wide)
    assert done.returncode == expect, done.stderr
    assert "Traceback" not in done.stderr
    return done
