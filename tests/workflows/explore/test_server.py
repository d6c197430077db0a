"""The gate of the local server: without the token, from a foreign page, or with another method nothing is answered."""

from __future__ import annotations

import asyncio
import http.client
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest

from pipeline.errors import UsageError

from .conftest import served

bokeh = pytest.importorskip("bokeh", reason="the extra [explore] is not installed")
from bokeh.models.widgets.markups import Div  # noqa: E402
from tornado.httpclient import HTTPClientError, HTTPRequest  # noqa: E402
from tornado.websocket import websocket_connect  # noqa: E402

from workflows.explore.look import Panel, page  # noqa: E402
from workflows.explore.server import serve  # noqa: E402

TEXT = "what the server serves"


def view(document: Any) -> None:
    page(document, TEXT, "Lead", [Panel(Div(text="words"), "Heading")])


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with served(view) as found:
        yield found


def ask(address: str, path: str | None = None, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], str]:
    """Status, headers and body of a request to the server at ``address``; ``path`` instead of its own."""
    parts = urlsplit(address)
    connection = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=20)
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    try:
        connection.putrequest(method, parts.path if path is None else path, skip_host="Host" in given)
        for name, value in given.items():
            connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read().decode(errors="replace")
    finally:
        connection.close()


def host(address: str) -> str:
    return urlsplit(address).netloc


def port(address: str) -> int:
    found = urlsplit(address).port
    assert found is not None
    return found


def test_the_page_is_served_with_its_policy(address: str) -> None:
    status, headers, body = ask(address)
    assert status == 200
    assert TEXT in body
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe-eval" not in policy
    assert "'unsafe-inline'" not in policy.split("script-src")[1].split(";")[0]
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cache-Control"] == "no-store"
    assert "http://" not in body.replace(f"http://{host(address)}", "")
    assert "https://" not in body


def test_the_server_listens_on_this_machine_alone(address: str) -> None:
    assert urlsplit(address).hostname == "127.0.0.1"
    assert len(urlsplit(address).path.strip("/")) >= 43  # 256 bits in base 64


def test_localhost_is_another_name_of_this_machine(address: str) -> None:
    own = f"localhost:{port(address)}"
    assert ask(address, Host=own)[0] == 200
    assert ask(address, Host=own, Origin=f"http://{own}")[0] == 200


@pytest.mark.parametrize(
    "path",
    [
        "/",
        "/ws",
        "/static/js/bokeh.min.js",
        "/favicon.ico",
        "/{wrong}/",
        "/{wrong}/ws",
        "/{short}/",
        "//{token}/",
        "/?token={token}",
    ],
)
def test_without_the_token_nothing_is_served(address: str, path: str) -> None:
    token = urlsplit(address).path.strip("/")
    wrong = token[:-1] + ("A" if token[-1] != "A" else "B")
    status, _, body = ask(address, path.format(token=token, wrong=wrong, short=token[:-1]))
    assert status == 403
    assert TEXT not in body
    assert token not in body


@pytest.mark.parametrize(
    "name", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1.evil.example:{port}", "localhost:1", ""]
)
@pytest.mark.parametrize("path", [None, "static/js/bokeh.min.js", "ws"])
def test_a_foreign_host_is_refused(address: str, name: str, path: str | None) -> None:
    whole = None if path is None else urlsplit(address).path + path
    assert ask(address, whole, Host=name.format(port=port(address)))[0] == 403


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "https://127.0.0.1:{port}", "http://127.0.0.1:1", "http://127.0.0.1", "null", "file://"],
)
def test_a_foreign_origin_is_refused(address: str, origin: str) -> None:
    assert ask(address, Origin=origin.format(port=port(address)))[0] == 403


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE"])
def test_only_reading_is_allowed(address: str, method: str) -> None:
    assert ask(address, method=method)[0] == 405


@pytest.mark.parametrize(
    "path", ["metadata", "autoload.js", "static/../../../../etc/passwd", "static/%2e%2e/%2e%2e/server.py", "x"]
)
def test_there_is_the_page_its_socket_and_scripts_and_nothing_else(address: str, path: str) -> None:
    status, headers, _ = ask(address, urlsplit(address).path + path)
    assert status in (403, 404)
    assert "Access-Control-Allow-Origin" not in headers


def test_the_scripts_are_served_from_here_whatever_the_environment_says(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BOKEH_RESOURCES", "cdn")
    _, _, body = ask(address)
    assert "cdn" not in body
    assert ask(address, urlsplit(address).path + "static/js/bokeh.min.js")[0] == 200


def _socket(address: str, token: str, **headers: str) -> str:
    """What the websocket says first, or the status with which it is refused."""

    async def connect() -> str:
        url = address.replace("http://", "ws://") + "ws"
        try:
            socket = await websocket_connect(HTTPRequest(url, headers=headers), subprotocols=["bokeh", token])
        except HTTPClientError as error:
            return str(error.code)
        said = await asyncio.wait_for(socket.read_message(), 20)
        socket.close()
        while said is not None and await socket.read_message() is not None:
            pass
        return "closed" if said is None else str(said)

    return asyncio.run(connect())


def _session_token(address: str) -> str:
    return ask(address)[2].split('"token":"')[1].split('"')[0]


def test_the_websocket_answers_its_own_page(address: str) -> None:
    assert "ACK" in _socket(address, _session_token(address), Origin=f"http://{host(address)}")


def test_the_websocket_refuses_other_pages_and_made_up_sessions(address: str) -> None:
    token = _session_token(address)
    assert _socket(address, token, Origin="http://evil.example") == "403"
    assert _socket(address, token, Host="evil.example") == "403"
    assert _socket(address.replace(urlsplit(address).path, "/other/"), token) == "403"
    assert _socket(address, token[:-2] + "xx", Origin=f"http://{host(address)}") == "closed"


def test_a_port_that_is_used_is_a_typed_error(address: str) -> None:
    with pytest.raises(UsageError, match="the port cannot be used"):
        asyncio.run(serve(view, port(address), print))
