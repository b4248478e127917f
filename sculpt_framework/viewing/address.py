"""Where the viewer may listen."""

import ipaddress
import os
import socket
import sys

from sculpt_framework.errors import ConfigError

HOST = "127.0.0.1"
PORT = 7007


def check_address(host: str, port: int, option: str) -> None:
    """Raise ConfigError if the viewer must not or cannot listen there. ``option`` is how the user chooses the port.

    The page has no access control and can stop a run, so it is for this machine alone. The server itself would go on to
    the next free port, or wait for ever for an address of another machine.
    """
    if not is_loopback(host):
        raise ConfigError(
            f"the viewer does not listen on {host}: whoever reaches the page can steer the run. Leave it on 127.0.0.1"
            f" and forward the port: ssh -L {port}:127.0.0.1:{port} {socket.gethostname()}, then open"
            f" http://127.0.0.1:{port}"
        )
    try:
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
            if os.name == "posix":
                # As the server does: a port whose last connection is still winding down is free.
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
    except (OSError, OverflowError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"the viewer cannot listen on {host}:{port} ({reason}); choose another {option}") from error


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def url(host: str, port: int) -> str:
    """Where a browser finds the page."""
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def announce(host: str, port: int) -> None:
    """Print where a browser finds the page, also from a machine that has logged in here."""
    sys.stdout.write(f"{url(host, port)}\n")
    if "SSH_CONNECTION" in os.environ:
        sys.stdout.write(f"from your own machine: ssh -L {port}:127.0.0.1:{port} HOST\n")
    sys.stdout.flush()
