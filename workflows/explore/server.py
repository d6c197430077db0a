"""A local server of one Bokeh document: loopback, one secret address, read-only.

Every request passes one gate, before any handler sees it:

    method      GET or HEAD, else 405
    Host        127.0.0.1:PORT or localhost:PORT, else 403: a foreign name that resolves to this machine (DNS rebinding)
    Origin      if there is one: the same two, else 403: another page that opens the websocket
    path        /TOKEN/..., compared in constant time, else 403
    handler     the page, its websocket and Bokeh's own static files, else 404

The token has 256 random bits; page, scripts and websocket need it.  It is a part of the path rather than a cookie, because
cookies of 127.0.0.1 are sent to every port of the machine.  Session ids are signed with a key of the process.  A
Content-Security-Policy lets the page load from this server alone and run its own scripts alone: inline scripts by their hash, no
``eval``.

Sources: RFC 6454 (Origin); W3C Content Security Policy Level 3; the Jupyter Server's checks of token, Host and Origin.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import os
import secrets
import socket
from collections.abc import Callable
from html.parser import HTMLParser
from typing import Any
from urllib.parse import urlsplit

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.embed.server import server_html_page_for_session
from bokeh.resources import Resources
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.doc_handler import DocHandler
from bokeh.server.views.static_handler import StaticHandler
from bokeh.server.views.ws import WSHandler
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.web import RequestHandler, authenticated

from pipeline.errors import UsageError

View = Callable[[Document], None]
_LOOPBACK = "127.0.0.1"
_NAMES = (_LOOPBACK, "localhost")
#: A session without a page is forgotten after this time [ms]; reloading makes a new one.
_FORGET_MS = 60_000


async def serve(view: View, port: int, ready: Callable[[str], None]) -> None:
    """Serve ``view`` until the task is cancelled.

    Parameters
    ----------
    view : fills the document of one session.
    port : TCP port; 0: a free one.
    ready : called with the address once the server listens.

    Raises
    ------
    UsageError : the port cannot be used.
    """
    listening = _listening(port)
    bound = int(listening.getsockname()[1])
    token = secrets.token_urlsafe(32)
    application = _Guarded(view, bound, token)
    http = HTTPServer(application)
    http.add_sockets([listening])
    server = BaseServer(IOLoop.current(), application, http)
    server.start()
    try:
        ready(f"http://{_LOOPBACK}:{bound}/{token}/")
        await asyncio.Event().wait()
    finally:
        server.stop()
        await http.close_all_connections()


def _listening(port: int) -> socket.socket:
    """A socket that listens on this machine alone; raises as :func:`serve`."""
    found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name != "nt":  # there it would let two programs listen on one port
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((_LOOPBACK, port))
        found.listen()
        found.setblocking(False)
    except (OSError, OverflowError) as error:
        found.close()
        reason = (getattr(error, "strerror", None) or str(error)).lower()
        raise UsageError(
            f"the port cannot be used: {reason}",
            value=port,
            allowed="a free port from 1024 to 65535, or 0 for any",
            next_step="leave --port out",
        ) from None
    return found


class _Guarded(BokehTornado):
    """Bokeh's application behind the gate."""

    def __init__(self, view: View, port: int, token: str) -> None:
        self._hosts = frozenset(f"{name}:{port}" for name in _NAMES)
        self._token = token
        super().__init__(
            {"/": Application(FunctionHandler(view))},
            prefix=token,
            extra_websocket_origins=sorted(self._hosts),
            secret_key=secrets.token_bytes(32),
            sign_sessions=True,
            use_index=False,
            include_headers=[],
            include_cookies=[],
            check_unused_sessions_milliseconds=_FORGET_MS,
            unused_session_lifetime_milliseconds=_FORGET_MS,
            # Refusals are answers, not news for the terminal.
            log_function=_silent,
        )
        self.port = port

    def resources(self, absolute_url: str | bool | None = None) -> Resources:
        """Bokeh's scripts from this server, whatever the environment says (BOKEH_RESOURCES)."""
        return Resources(mode="server", root_url=f"/{self._token}/", path_versioner=StaticHandler.append_version)

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> Any:
        """The handler of a request, or its refusal."""
        refused = self._refused(request)
        if refused is not None:
            return self.get_handler_delegate(request, _RefusedRequest, {"status": refused})
        delegate = super().find_handler(request, **kwargs)
        allowed = {DocHandler: _Page, WSHandler: WSHandler, StaticHandler: _Static}
        handler = allowed.get(getattr(delegate, "handler_class", None))
        if handler is None:
            return self.get_handler_delegate(request, _RefusedRequest, {"status": 404})
        delegate.handler_class = handler
        return delegate

    def _refused(self, request: HTTPServerRequest) -> int | None:
        """The status with which the gate refuses the request; ``None`` lets it pass."""
        if request.method not in ("GET", "HEAD"):
            return 405
        origins = request.headers.get_list("Origin") + request.headers.get_list("Sec-Websocket-Origin")
        foreign = any(
            urlsplit(origin).scheme != "http" or urlsplit(origin).netloc not in self._hosts for origin in origins
        )
        if request.headers.get_list("Host") not in [[host] for host in self._hosts] or foreign:
            return 403
        first = request.path.removeprefix("/").partition("/")[0]
        return None if hmac.compare_digest(first.encode(), self._token.encode()) else 403


def _silent(handler: RequestHandler) -> None:
    """The log of requests: nothing."""


def _headers(handler: RequestHandler) -> None:
    """Headers of every answer."""
    for name, value in (
        ("Server", "gyroscreen"),
        ("X-Content-Type-Options", "nosniff"),
        ("X-Frame-Options", "DENY"),
        ("Referrer-Policy", "no-referrer"),
        ("Cross-Origin-Opener-Policy", "same-origin"),
        ("Cross-Origin-Resource-Policy", "same-origin"),
        ("Content-Security-Policy", "default-src 'none'; frame-ancestors 'none'"),
    ):
        handler.set_header(name, value)


class _RefusedRequest(RequestHandler):
    """One line of text with a status."""

    def initialize(self, status: int) -> None:
        """``status`` of the answer."""
        self.refused = status

    def set_default_headers(self) -> None:
        """Headers of every answer."""
        _headers(self)

    async def prepare(self) -> None:
        """Answer whatever was asked."""
        words = {
            403: "Refused. Open the whole address that gyroscreen explore printed.",
            404: "There is nothing here.",
            405: "Refused. This server is read-only.",
        }
        self.set_status(self.refused)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{words[self.refused]}\n")


class _Static(StaticHandler):
    """Bokeh's own scripts."""

    def set_default_headers(self) -> None:
        """Headers of every answer."""
        _headers(self)


class _Page(DocHandler):
    """The page of a session."""

    application: _Guarded

    def set_default_headers(self) -> None:
        """Headers of every answer."""
        _headers(self)

    @authenticated
    async def get(self, *args: Any, **kwargs: Any) -> None:
        """The page with a policy that names its own scripts."""
        session = await self.get_session()
        document = session.document
        page = server_html_page_for_session(
            session,
            resources=self.application.resources(),
            title=document.title,
            template=document.template,
            template_variables=document.template_variables,
        )
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.set_header("Cache-Control", "no-store")
        self.set_header("Content-Security-Policy", _policy(page, self.application.port))
        self.write(page)


def _policy(page: str, port: int) -> str:
    """Content-Security-Policy of a page: this server alone, and the inline scripts that the page has now."""
    sockets = " ".join(f"ws://{name}:{port}" for name in _NAMES)
    rules = {
        "default-src": "'none'",
        "script-src": " ".join(["'self'", *_hashes(page)]),
        # Bokeh writes the sizes of its elements as inline styles.
        "style-src": "'self' 'unsafe-inline'",
        "img-src": "'self' data: blob:",
        "font-src": "'self' data:",
        "connect-src": f"'self' {sockets}",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": "'none'",
    }
    return "; ".join(f"{name} {value}" for name, value in rules.items())


class _InlineScripts(HTMLParser):
    """Collects the text of inline scripts."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=False)
        self.found: list[str] = []
        self._inside = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """A script without a source starts."""
        if tag == "script" and not any(name == "src" for name, _ in attrs):
            self._inside = True
            self.found.append("")

    def handle_endtag(self, tag: str) -> None:
        """A script ends."""
        if tag == "script":
            self._inside = False

    def handle_data(self, data: str) -> None:
        """Text of a script."""
        if self._inside:
            self.found[-1] += data


def _hash(script: str) -> str:
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return f"'sha256-{digest}'"


def _hashes(page: str) -> list[str]:
    """The hashes of the inline scripts of a page."""
    parser = _InlineScripts()
    parser.feed(page)
    return [_hash(script) for script in parser.found]
