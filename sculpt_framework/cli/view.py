"""``sculpt-view``: a run in the browser, finished, running or killed."""

import json
import logging
import os
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from sculpt_framework.cli import exit_codes
from sculpt_framework.errors import CheckpointError
from sculpt_framework.viewing.address import HOST, PORT, announce, check_address, url

if TYPE_CHECKING:
    from sculpt_framework.commands import Command

_NICE = 10
"""A viewer gives way to training."""


@dataclass(frozen=True, kw_only=True)
class ViewRequest:
    """Show a run in the browser: its surface, Gaussians, cameras, plots and decisions, and how it came to be."""

    run_dir: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_DIR")]
    """Run directory: of a run that has finished, goes on, or was killed."""
    host: str = HOST
    """Address to listen on: one of this machine's own. Other machines come through an SSH tunnel."""
    port: int = PORT
    """Port to listen on."""
    steer: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Write commands to the standard output, and end with the standard input: what training starts."""


def main() -> None:
    """The console script ``sculpt-view``."""
    exit_codes.run(lambda: view(sys.argv[1:]))


def view(words: Sequence[str]) -> None:
    """Serve the page until Ctrl-C. Raises SculptError; exits as tyro does for ``--help`` and wrong values."""
    request = tyro.cli(ViewRequest, args=words, prog="sculpt-view")
    if not (request.run_dir / "config.json").is_file():
        raise CheckpointError(f"{request.run_dir} is not a run directory: it has no config.json")
    check_address(request.host, request.port, "--port")
    if sys.platform != "win32":
        os.nice(_NICE)
    logging.basicConfig(format="%(message)s", stream=sys.stderr)
    # It would tell with a traceback of everybody who opens the port and hangs up.
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    from sculpt_framework.viewing.show import Show

    if request.steer:
        _steer(request)
        return
    show = Show(request.run_dir, request.host, request.port)
    announce(request.host, show.port)
    try:
        show.loop(threading.Event())
    finally:
        show.close()


def _steer(request: ViewRequest) -> None:
    """As a part of a training run: one JSON object a line to the standard output."""
    from sculpt_framework.commands import command_to_json
    from sculpt_framework.viewing.show import Show

    lock = threading.Lock()
    ended = threading.Event()

    def say(what: dict[str, object]) -> None:
        try:
            with lock:
                sys.stdout.write(json.dumps(what) + "\n")
                sys.stdout.flush()
        except BrokenPipeError:
            ended.set()

    def send(command: "Command") -> None:
        say({"command": command_to_json(command)})

    def wait_for_end() -> None:
        while sys.stdin.read(1):
            pass
        ended.set()

    threading.Thread(target=wait_for_end, name="end", daemon=True).start()
    show = Show(request.run_dir, request.host, request.port, send)
    say({"listening": url(request.host, show.port)})
    show.loop(ended, lambda watching: say({"watching": watching}))
    show.close()


if __name__ == "__main__":
    main()
