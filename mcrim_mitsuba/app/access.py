"""Who may speak with the page: the browser of the person who started it, and nobody else.

The page listens on this machine alone, but any web site that is open in the same browser can
send requests there, and so can the other users of the machine. So a request must name this
address as its host (a site that lets its own name point here does not), must not come from
another site's page (browsers say so themselves), and must know a key that changes with every
start and stands in the address. What the page may load, and who may show it in a frame, is told
to the browser in the headers of every answer.
"""

from __future__ import annotations

import errno
import hmac
import os
import re
import secrets
import socket
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from werkzeug.datastructures import Headers
from werkzeug.exceptions import HTTPException
from werkzeug.serving import BaseWSGIServer, WSGIRequestHandler, make_server
from werkzeug.wrappers import Response

from mcrim_mitsuba.core.errors import InputError

if TYPE_CHECKING:
    from _typeshed.wsgi import StartResponse, WSGIApplication, WSGIEnvironment
    from flask import Flask


#: Bytes that a request may carry; an uploaded file grows by a third on its way.
LARGEST_BODY = 12_000_000
#: How long a refused client may go on sending.
_SWALLOWED_S = 30.0
#: How long it may say nothing meanwhile.
_SILENCE_S = 2.0
_ASSETS = "assets/"
_LENGTH = re.compile(r"[0-9]{1,12}")


def new_key() -> str:
    """A key that nobody can guess, of letters that an address may hold."""
    return secrets.token_urlsafe(24)


class Guard:
    """Lets only the owner's browser reach an application that lives below ``/<key>/``.

    It stands before all of Flask, its routing and its error pages included. What is refused is
    answered by one line of text; the honest user sees it too, with an old address for instance, so
    it says what to do.
    """

    def __init__(self, application: WSGIApplication, port: int, key: str) -> None:
        self.application = application
        self.hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        self.home = f"/{key}/"
        self.assets = self.home + _ASSETS

    def __call__(self, environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
        refusal = self._refusal(environ)
        if refusal is not None:
            refusal.call_on_close(partial(_swallow, environ))
        answer = refusal or self.application
        is_asset = refusal is None and environ["PATH_INFO"].startswith(self.assets)
        ours = _HEADERS if is_asset else _HEADERS | {"Cache-Control": "no-store"}

        def start(
            status: str, headers: list[tuple[str, str]], *error: Any
        ) -> Callable[[bytes], object]:
            guarded = Headers(headers)
            guarded.update(ours)
            return start_response(status, guarded.to_wsgi_list(), *error)

        return answer(environ, start)

    def _refusal(self, environ: WSGIEnvironment) -> Response | None:
        """Why this request is refused, as an answer; None if it may pass."""
        if environ.get("HTTP_HOST") not in self.hosts:
            return _refuse(
                HTTPStatus.FORBIDDEN,
                f"this page answers at http://{self.hosts[0]} only: open the address that "
                "mcrim app printed, and through ssh forward the same port number",
            )
        # as bytes: comparing texts in constant time takes ASCII only
        start = environ["PATH_INFO"][: len(self.home)].encode(errors="replace")
        if not hmac.compare_digest(start, self.home.encode()):
            return _refuse(
                HTTPStatus.FORBIDDEN,
                "the address lacks the key of this session: open the address that mcrim app "
                "printed, all of it; every start makes a new one",
            )
        if not self._is_at_home(environ):
            words = "another web page sent this request: open the address that mcrim app printed"
            return _refuse(HTTPStatus.FORBIDDEN, words)
        return _refusal_of_form(environ)

    def _is_at_home(self, environ: WSGIEnvironment) -> bool:
        """Whether the page itself, or its user, sent this, by what the browser says of it."""
        origin = environ.get("HTTP_ORIGIN")
        if origin is not None and origin != f"http://{environ['HTTP_HOST']}":
            return False
        site = environ.get("HTTP_SEC_FETCH_SITE")
        if site in (None, "same-origin", "none"):  # none: the user typed or clicked the address
            return True
        # A link with the key in a terminal that is itself a web page: it may open this page, which
        # changes nothing, in a tab of its own, which that page cannot look into.
        return (
            environ["REQUEST_METHOD"] == "GET"
            and environ["PATH_INFO"] == self.home
            and environ.get("HTTP_SEC_FETCH_MODE") == "navigate"
            and environ.get("HTTP_SEC_FETCH_DEST") == "document"
        )


def _refusal_of_form(environ: WSGIEnvironment) -> Response | None:
    """A request of a form that the page does not use; other sites could send some of these."""
    method = environ["REQUEST_METHOD"]
    if method == "GET":
        return None
    if method != "POST":
        answer = _refuse(HTTPStatus.METHOD_NOT_ALLOWED, "this page takes GET and POST only")
        answer.headers["Allow"] = "GET, POST"
        return answer
    if environ.get("CONTENT_TYPE", "").partition(";")[0].strip().lower() != "application/json":
        return _refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "this page takes JSON only")
    length = environ.get("CONTENT_LENGTH", "")
    if not _LENGTH.fullmatch(length) or "HTTP_TRANSFER_ENCODING" in environ:
        return _refuse(HTTPStatus.LENGTH_REQUIRED, "the length of the request is not given")
    if int(length) > LARGEST_BODY:
        return _refuse(
            HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
            f"the request has {int(length) / 1e6:.0f} MB; this page takes "
            f"{LARGEST_BODY / 1e6:.0f} MB at most, so upload a smaller file",
        )
    return None


def _swallow(environ: WSGIEnvironment) -> None:
    """Read what a client that was answered still sends: cut off, it would not read the answer."""
    length = environ.get("CONTENT_LENGTH", "")
    left, end = int(length) if _LENGTH.fullmatch(length) else 0, time.monotonic() + _SWALLOWED_S
    environ["werkzeug.socket"].settimeout(_SILENCE_S)
    with suppress(OSError):
        while left > 0 and time.monotonic() < end:
            read = len(environ["wsgi.input"].read1(min(left, 1 << 16)))
            left = left - read if read else 0


def _refuse(status: HTTPStatus, line: str) -> Response:
    return Response(f"mcrim app: {line}\n", status, mimetype="text/plain")


#: What the browser may load and run: what the page serves itself, and no inline scripts or styles.
_POLICY = (
    "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
#: Headers of every answer: the browser is to load nothing from elsewhere, and show nothing there.
_HEADERS = {
    "Content-Security-Policy": _POLICY,
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",  # the address holds the key
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}


# Serves the page on this machine, guarded, until it is interrupted.

HOST = "127.0.0.1"
LARGEST_PORT = 65535


def serve(
    application: Flask, *, port: int | None, key: str, on_ready: Callable[[str], None]
) -> None:
    """Serve a page until Ctrl-C, in the main thread.

    All of the page lies below ``/<key>/``, `key` being a secret as `new_key` makes them. The `port`
    is one of this machine; None takes any free one. `on_ready` is called once, with the page's
    address, when browsers can open it.

    Raises InputError if the port is taken, or cannot be one.
    """
    server, address = listen(application, port=port, key=key)
    # an interrupt before serve_forever; later it ends that as if it were asked to
    with server, suppress(KeyboardInterrupt):
        on_ready(address)
        server.serve_forever()


def listen(application: Flask, *, port: int | None, key: str) -> tuple[BaseWSGIServer, str]:
    """A server that listens already, and the page's address; see `serve`.

    Requests wait until ``serve_forever`` of the server runs. ``shutdown``, from another thread,
    ends it.
    """
    # The port is bound before anything is told of it: nobody can take it in between.
    with _bound(port) as bound:
        number = bound.getsockname()[1]
        application.register_error_handler(Exception, in_one_line)
        # Flask's own way to stand before it
        application.wsgi_app = Guard(application.wsgi_app, number, key)  # type: ignore[method-assign]
        how: dict[str, Any] = {"threaded": True, "request_handler": _SilentHandler}
        server = make_server(HOST, number, application, fd=bound.fileno(), **how)
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
        problem = f"{port} is no port"
        raise InputError(problem, f"give one from 1024 to {LARGEST_PORT}, or none for a free one")
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


def in_one_line(error: Exception) -> Response:
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
