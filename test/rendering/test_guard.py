"""Who may load the page and open its websocket: real requests to a real viewer."""

import gzip
import http.client
import re
import signal

import pytest

pytest.importorskip("viser")
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from helpers.patience import LIMIT
from helpers.ros import browser as browsers
from helpers.ros.processes import Process
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.ports import free_port
from tissue_sim.rendering.guard import Guard, guarding, titled
from tissue_sim.ros.viewer.tokens import chosen_token

VISER = f"viser-v{viser.__version__}"
TOKEN = "of-the-users-own_1"


@pytest.fixture
def serve(tmp_path):
    """Starts a viewer with options; (process, port). At the end it must have said nothing but its address."""
    started = []

    def one(*words, **environment):
        port = free_port()
        log = tmp_path / f"{len(started)}.log"
        process = Process(["-m", "tissue_sim", "view", "--port", str(port), *words], log, **environment)
        started.append(process)
        process.wait_for("open http")
        return process, port

    yield one
    for process in started:
        code, said = process.stop(signal.SIGINT), process.text()
        assert (code, said.count("\n")) == (0, 1), said


def get(port, path="/", **headers):
    """Status, headers and text of a page."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=LIMIT)
    connection.request("GET", path, headers={name.title(): value for name, value in headers.items()})
    answer = connection.getresponse()
    return answer.status, answer.headers, answer.read().decode()


def websocket(port, path="/", origin=None, **headers):
    """What a websocket gets: 101 and the first message, or the status that it is refused with."""
    try:
        with connect(
            f"ws://127.0.0.1:{port}{path}",
            subprotocols=[VISER],
            origin=origin,
            additional_headers=headers,
            max_size=None,
            open_timeout=LIMIT,
        ) as socket:
            assert socket.recv(timeout=LIMIT)
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


@pytest.mark.extended
def test_beyond_this_machine_page_and_websocket_need_the_token(serve):
    process, port = serve("--host", "0.0.0.0")
    token = re.fullmatch(rf"open http://127\.0\.0\.1:{port}/\?token=([\w-]{{43}})\n", process.text())[1]
    for path in ("/", "/index.html", "/?token=", f"/?token={token[:-1]}", f"/?token={token}x", "/?token=%ff", "//["):
        status, headers, text = get(port, path)
        assert status == 403, path
        assert "Set-Cookie" not in headers
        assert text.count("\n") == 1
        assert "<" not in text
    assert websocket(port) == 403
    assert websocket(port, Cookie=f"tissue_sim_{port}={token[:-1]}") == 403
    assert websocket(port, Cookie=f"tissue_sim={token}") == 403

    status, headers, text = get(port, f"/?token={token}")
    assert (status, "<html" in text) == (200, True)
    assert "frame-ancestors 'self'" in headers["Content-Security-Policy"]
    cookie, *attributes = headers["Set-Cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Strict"} < set(attributes)
    assert get(port, cookie=cookie)[0] == 200
    assert websocket(port, Cookie=f"other=1; {cookie}") == 101
    assert websocket(port, f"/?token={token}") == 101
    assert websocket(port, origin="http://elsewhere.example", Cookie=cookie) == 403


@pytest.mark.extended
def test_a_token_of_the_users_own_holds_on_loopback_too(serve):
    for words, environment in ((["--token", TOKEN], {}), ([], {"TISSUE_SIM_TOKEN": TOKEN})):
        process, port = serve(*words, **environment)
        assert process.text() == f"open http://127.0.0.1:{port}/?token={TOKEN}\n"
        assert get(port)[0] == 403
        assert get(port, f"/?token={TOKEN}")[0] == 200
        # A proxy of the user's, which goes by a name of its own.
        assert get(port, f"/?token={TOKEN}", host="theatre.example")[0] == 200


@pytest.mark.extended
def test_on_loopback_no_other_web_page_drives_the_tools(serve):
    _, port = serve()
    own = f"127.0.0.1:{port}"
    assert get(port)[0] == 200
    assert websocket(port) == 101
    assert websocket(port, origin=f"http://{own}") == 101
    for origin in (
        "http://elsewhere.example",
        "null",
        "http://127.0.0.1",
        f"http://{own}.elsewhere.example",
        "http://[",
    ):
        assert websocket(port, origin=origin) == 403, origin
    # A name that its owner made to point here: page and websocket agree, and it still isn't this machine's.
    assert get(port, host=f"rebound.example:{port}")[0] == 403
    for host in (f"localhost:{port}", f"[::1]:{port}", f"LOCALHOST:{port}"):
        assert get(port, host=host)[0] == 200, host


@pytest.mark.extended
@pytest.mark.skipif(browsers.program() is None, reason="no Chromium here")
def test_a_browser_with_the_token_gets_the_page_going(serve, tmp_path):
    process, port = serve("--host", "0.0.0.0")
    page = browsers.Browser(tmp_path)
    try:
        page.open(f"http://127.0.0.1:{port}/")
        page.wait_for_text("?token=")
        page.open(process.text().split()[1])
        page.wait_for_text("tissue_sim")  # of the panel, which comes over the websocket
    finally:
        page.close()


def test_a_token_is_made_where_it_is_needed():
    assert [chosen_token(None, host) for host in ("127.0.0.1", "localhost", "::1", "127.3.2.1")] == [None] * 4
    for host in ("0.0.0.0", "::", "192.0.2.1"):
        assert len({chosen_token(None, host), chosen_token(None, host)}) == 2
    assert chosen_token(TOKEN, "127.0.0.1") == TOKEN


@pytest.mark.parametrize("token", ["short", "sixteen and more, with blanks", "ü" * 20])
def test_a_token_that_could_be_guessed_is_wrong_use(token, capfd):
    assert main(["view", "--port", str(free_port()), "--token", token]) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert "16 or more" in error


def test_a_viser_that_cannot_be_guarded_is_not_served():
    with pytest.raises(UserError, match="install viser"), guarding(Guard(None, 8080)):
        pass


def test_the_page_has_our_name_and_all_else_stays():
    page = b"<html><title>Viser</title></html>"
    assert titled(page) == b"<html><title>tissue_sim</title></html>"
    assert gzip.decompress(titled(gzip.compress(page))) == titled(page)
    for other in (b"", b"{}", gzip.compress(b"window.title")):
        assert titled(other) == other
