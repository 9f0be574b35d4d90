"""Serves the page on this machine, behind its gate, until it is interrupted."""

from __future__ import annotations

import errno
import os
import socket
import sys
import traceback
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from werkzeug.exceptions import HTTPException
from werkzeug.serving import BaseWSGIServer, WSGIRequestHandler, make_server
from werkzeug.wrappers import Response

from mcrim_mitsuba.app.gate import guard
from mcrim_mitsuba.errors import InputError

if TYPE_CHECKING:
    from dash import Dash

HOST = "127.0.0.1"
LARGEST_PORT = 65535


def serve(
    application: Dash, *, port: int | None, key: str, on_ready: Callable[[str], None]
) -> None:
    """Serve a page until Ctrl-C, in the main thread.

    Parameters
    ----------
    application : dash.Dash
        The page, mounted below ``/<key>/``, with all its callbacks.
    port : int or None
        Where to listen on 127.0.0.1; None takes any free port.
    key : str
        The secret first part of every path.
    on_ready : callable
        Called once, with the page's address, when browsers can open it.

    Raises
    ------
    InputError
        If the port is taken, or cannot be one.
    """
    server, address = listen(application, port=port, key=key)
    try:
        on_ready(address)
        server.serve_forever()
    except KeyboardInterrupt:  # before serve_forever; later it ends that as if it were asked to
        pass
    finally:
        server.server_close()


def listen(application: Dash, *, port: int | None, key: str) -> tuple[BaseWSGIServer, str]:
    """A server that listens already, and the page's address; see `serve`.

    Requests wait until ``serve_forever`` of the server runs. ``shutdown``, from another thread,
    ends it.
    """
    # The port is bound before anything is told of it: nobody can take it in between.
    with _bound(port) as bound:
        number = bound.getsockname()[1]
        flask = application.server
        flask.register_error_handler(Exception, _one_line)
        guard(flask, port=number, key=key, script_hashes=application.csp_hashes())
        server = make_server(
            HOST, number, flask, threaded=True, request_handler=_SilentHandler, fd=bound.fileno()
        )
        tell = server.handle_error

        def handle_error(request: Any, client_address: Any) -> None:
            """An interrupt closes the socket of a request whose thread has just begun."""
            if not isinstance(sys.exception(), OSError):
                tell(request, client_address)

        server.handle_error = handle_error  # type: ignore[method-assign]  # the class is not ours
    return server, f"http://{HOST}:{number}/{key}/"


def _bound(port: int | None) -> socket.socket:
    """A socket that listens on this machine alone."""
    if port is not None and not 1 <= port <= LARGEST_PORT:
        raise InputError(
            f"{port} is no port", f"give one from 1024 to {LARGEST_PORT}, or none for a free one"
        )
    bound = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # a port left a moment ago may be used again; elsewhere: be shared
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((HOST, port or 0))
        bound.listen(BaseWSGIServer.request_queue_size)
    except OSError as error:
        bound.close()
        if error.errno == errno.EADDRINUSE:
            problem = f"port {port} is taken by another program"
        elif error.errno == errno.EACCES:
            problem = f"port {port} is not yours to use"
        else:
            raise
        raise InputError(problem, "give another, or none for a free one") from None
    return bound


def _one_line(error: Exception) -> Response:
    """What a failed request is answered; ours are told in full where `mcrim` was started."""
    if isinstance(error, HTTPException):
        return Response(f"mcrim app: {error.name}\n", error.code, mimetype="text/plain")
    traceback.print_exception(error)
    line = "this is our fault, not yours: please report the lines"
    print(f"mcrim app: {line} above", file=sys.stderr)
    return Response(f"mcrim app: {line} in the terminal\n", 500, mimetype="text/plain")


class _SilentHandler(WSGIRequestHandler):
    """Says nothing of single requests, and does not name its versions."""

    def log(self, type: str, message: str, *args: Any) -> None:
        pass

    def version_string(self) -> str:
        return "mcrim"
