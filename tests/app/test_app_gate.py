"""The page's gate, at a real socket: who gets in, and who does not, whatever they know."""

import errno
import http.client
import http.server
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import flask
import pytest
from browser import open_browser, why_no_browser
from places import cases_of

from mcrim_mitsuba.app.access import LARGEST_BODY, listen, new_key
from mcrim_mitsuba.core.errors import InputError

cases = cases_of(__file__)

SECRET = "light yield 7.68"
EVIL = "evil.test"
COUNT = json.dumps({"what": "count", "name": "x"})
MARKUP = """<!doctype html><title>small</title><script type="module" src="assets/small.js"></script>
<link rel="stylesheet" href="assets/small.css"><link rel="icon" href="assets/icon.svg">
<p id="secret">{}</p><button id="count">count</button><p id="said"></p>"""
ASSETS = {
    "small.js": """
        document.querySelector('#count').addEventListener('click', async () => {
            const headers = {'Content-Type': 'application/json'};
            const body = JSON.stringify({what: 'count', name: 'x'});
            const answer = await fetch('do', {method: 'POST', headers, body});
            const link = Object.assign(document.createElement('a'), {href: 'file', download: ''});
            link.click();
            document.querySelector('#said').textContent = (await answer.json()).said;
        });""",
    "small.css": "#secret { color: rgb(1, 2, 3); }",
    "icon.svg": "<svg xmlns='http://www.w3.org/2000/svg'/>",
}


def small_page(key: str, assets: Path) -> SimpleNamespace:
    """A page of all the parts that mcrim's page uses, and what passed the gate to it."""
    page = SimpleNamespace(counted=0, passed=[])
    for name, text in ASSETS.items():
        (assets / name).write_text(text)
    page.application = app = flask.Flask(
        __name__, static_folder=assets, static_url_path=f"/{key}/assets"
    )
    app.before_request(lambda: page.passed.append(flask.request.path))
    app.get(f"/{key}/")(lambda: MARKUP.format(SECRET))
    app.get(f"/{key}/state", endpoint="state")(lambda: {"secret": SECRET})
    table = {"Content-Disposition": "attachment; filename=table.csv"}
    app.get(f"/{key}/file", endpoint="file")(lambda: flask.Response("a,b\n", headers=table))

    @app.post(f"/{key}/do")
    def act():
        if flask.request.get_json()["what"] == "fail":
            raise RuntimeError("a slip of ours")
        page.counted += 1
        return {"said": f"counted {page.counted}"}

    return page


@contextmanager
def running(server):
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()


@pytest.fixture
def page(tmp_path):
    key = new_key()
    small = small_page(key, tmp_path)
    server, address = listen(small.application, port=None, key=key)
    small.key, small.port, small.address = key, server.port, address
    with running(server):
        yield small


def ask(page, method="GET", path=None, body=None, **headers):
    """Status, headers and text of the answer to one request."""
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=20)
    named = {"Host": f"127.0.0.1:{page.port}"}
    named |= {name.replace("_", "-"): value for name, value in headers.items()}
    if body is not None:
        named.setdefault("Content-Type", "application/json")
    connection.putrequest(method, f"/{page.key}/" if path is None else path, skip_host=True)
    if body is not None and "Content-Length" not in named:
        named["Content-Length"] = str(len(body))
    for name, value in named.items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders()
    if body:
        connection.send(body.encode())
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, answer.headers, text


def press(page, **headers):
    """Press the page's button without a browser."""
    return ask(page, "POST", f"/{page.key}/do", COUNT, **headers)


def test_the_owner_gets_in(page):
    own = f"http://127.0.0.1:{page.port}"
    status, headers, text = ask(page)
    assert status == 200 and "assets/small.js" in text
    assert headers["Cache-Control"] == "no-store"
    assert ask(page, Host=f"localhost:{page.port}")[0] == 200
    for named in ({}, {"Origin": own}, {"Origin": own, "Sec-Fetch-Site": "same-origin"}):
        assert press(page, **named)[0] == 200
    assert page.counted == 3
    status, headers, _ = ask(page, path=f"/{page.key}/assets/small.js")
    assert status == 200 and headers["Cache-Control"] != "no-store"
    # a link in a terminal that is a web page
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    assert ask(page, **link, **{"Sec-Fetch-Dest": "document"})[0] == 200


def test_every_answer_forbids_frames_and_foreign_scripts(page):
    for path in (None, "/", f"/{page.key}/state", f"/{page.key}/assets/x/y"):
        _, headers, _ = ask(page, path=path)
        policy = headers["Content-Security-Policy"]
        assert "frame-ancestors 'none'" in policy and "default-src 'self'" in policy
        assert "unsafe" not in policy and "sha256" not in policy
        assert headers["X-Frame-Options"] == "DENY"
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Referrer-Policy"] == "no-referrer"
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        assert headers["Cross-Origin-Opener-Policy"] == "same-origin"
        assert not [name for name in headers if name.startswith("Access-Control")]
        assert headers["Server"] == "mcrim"


@cases("host", more=[None])
def test_a_name_that_is_not_ours_is_refused(page, host):
    host = host and host.format(port=page.port)
    for status, _, text in (ask(page, Host=host), press(page, Host=host)):
        assert status == 403 and text.count("\n") == 1 and SECRET not in text
        assert f"http://127.0.0.1:{page.port} only" in text
    assert page.passed == []


@cases("path")
def test_no_key_no_page(page, path):
    path = path.format(key=page.key, less=page.key[:-1], wrong=new_key())
    status, _, text = ask(page, path=path)
    assert (status, page.passed) == (403, [])
    assert "open the address that mcrim app printed" in text and text.count("\n") == 1


@cases("headers")
def test_another_page_is_refused_even_with_the_key(page, headers):
    headers = {name: value.format(port=page.port) for name, value in headers.items()}
    framed = headers | {"Sec-Fetch-Dest": "iframe"}
    layout = f"/{page.key}/state"
    for answer in (press(page, **headers), ask(page, path=layout, **headers), ask(page, **framed)):
        assert answer[0] == 403 and "another web page sent this" in answer[2]
    assert (page.counted, page.passed) == (0, [])


@cases(
    "method",
    "headers",
    "status",
    more=[
        ("POST", {"Content-Type": None}, 415),
        ("POST", {"Content-Length": str(LARGEST_BODY + 1)}, 413),
        ("POST", {"Content-Length": "9" * 5000}, 411),
        ("POST", {"Content-Length": None}, 411),
    ],
)
def test_forms_of_request_that_the_page_does_not_use(page, method, headers, status):
    given, named, text = ask(page, method, f"/{page.key}/do", COUNT, **headers)
    assert given == status and (text.count("\n") == 1 or method == "HEAD")
    assert not [name for name in named if name.startswith("Access-Control")]
    assert (page.counted, page.passed) == (0, [])


def test_a_large_body_is_refused_before_it_is_kept(page):
    body = '{"x": "' + "x" * LARGEST_BODY + '"}'
    status, _, text = ask(page, "POST", f"/{page.key}/do", body)
    assert status == 413 and "12 MB at most" in text and page.passed == []


def test_who_sends_slowly_reads_why_it_is_refused(page):
    head = (
        f"POST /{page.key}/do HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n"
        f"Content-Type: application/json\r\nContent-Length: {LARGEST_BODY + 1}\r\n\r\n"
    )
    with socket.create_connection(("127.0.0.1", page.port), timeout=20) as client:
        client.sendall(head.encode())
        for _ in range(4):  # longer than werkzeug itself would listen on
            time.sleep(0.05)
            client.sendall(b"x" * (LARGEST_BODY // 4))
        assert client.recv(1 << 16).startswith(b"HTTP/1.1 413")


def test_our_slips_are_one_line_for_the_page_and_whole_in_the_terminal(page, capsys):
    failing = COUNT.replace("count", "fail")
    status, headers, text = ask(page, "POST", f"/{page.key}/do", failing)
    assert (status, text.count("\n")) == (500, 1) and "slip" not in text and "Trace" not in text
    assert "nosniff" in headers["X-Content-Type-Options"]
    told = capsys.readouterr().err
    assert "RuntimeError: a slip of ours" in told and told.endswith("report the lines above\n")
    for body in ("{", "[]"):
        status, _, text = ask(page, "POST", f"/{page.key}/do", body)
        assert status in (400, 500) and text.count("\n") == 1


def test_other_addresses_of_this_machine_are_closed(page):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing: which address would be ours?
            own = probe.getsockname()[0]
        except OSError:
            own = "127.0.0.2"
    for address in (own, "127.0.0.2", "::1"):
        with pytest.raises(OSError):
            socket.create_connection((address, page.port), timeout=2).close()


def test_ports_that_cannot_be(page):
    other = flask.Flask("other")
    with pytest.raises(InputError, match=f"port {page.port} is taken by another program; give"):
        listen(other, port=page.port, key="k")
    for port in (0, -1, 65536):
        with pytest.raises(InputError, match=f"{port} is no port; give one from 1024 to 65535"):
            listen(other, port=port, key="k")


def test_a_request_that_an_interrupt_closes_says_nothing(capsys):
    server, _ = listen(flask.Flask("other"), port=None, key="k")
    for error, told in ((OSError(errno.EBADF, "closed"), False), (RuntimeError("ours"), True)):
        try:
            raise error
        except Exception:
            server.handle_error(None, ("127.0.0.1", 1))
        assert ("ours" in capsys.readouterr().err) == told
    server.server_close()


@pytest.mark.skipif(os.name != "posix", reason="signals of another kind")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ends_at_once_when_interrupted(number):
    code = """if True:
        import signal, time, flask
        from mcrim_mitsuba.app.access import serve
        server = flask.Flask("slow")
        server.add_url_rule("/k/", view_func=lambda: time.sleep(60) or "")
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        serve(server, port=None, key="k", on_ready=lambda address: print(address, flush=True))
        print("ended", flush=True)
    """
    process = subprocess.Popen([sys.executable, "-c", code], stdout=-1, stderr=-1, text=True)
    address = process.stdout.readline().strip()
    host, _, path = address.removeprefix("http://").partition("/")
    connection = http.client.HTTPConnection(host)  # one request is being answered meanwhile
    connection.request("GET", f"/{path}")
    process.send_signal(number)
    out, err = process.communicate(timeout=5)
    assert (process.returncode, out, err) == (0, "ended\n", "")


# --- in a browser ---

ATTACKS = Path(__file__).with_name("attacks.js").read_text()


@pytest.fixture
def elsewhere():
    """Port of another server on this machine, whose pages are empty."""

    class Blank(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>elsewhere</title><body>")

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Blank) as server, running(server):
        yield server.server_port


@pytest.fixture
def rebound(tmp_path):
    """A browser for which evil.test is this machine, as after DNS rebinding."""
    if lacking := why_no_browser():
        pytest.skip(f"{lacking}: nothing is tested in a browser")
    with open_browser(tmp_path, f"--host-resolver-rules=MAP {EVIL} 127.0.0.1") as opened:
        yield opened


def test_pages_from_elsewhere_neither_read_nor_drive(page, elsewhere, rebound):
    knowing = page.key
    for host in ("127.0.0.1", "localhost", EVIL):
        for key in (new_key(), knowing):
            rebound.driver.get(f"http://{host}:{elsewhere}/")
            target = f"127.0.0.1:{page.port}/{key}/"
            tried = rebound.run(ATTACKS, f"http://{target}", f"ws://{target}", COUNT)
            assert set(tried.values()) == {"refused"}, (host, key == knowing, tried)
            rebound.driver.switch_to.frame("framed")  # what its user would see there
            assert SECRET not in rebound.driver.page_source
            assert (page.counted, page.passed) == (0, []), (host, key == knowing)

    # A page that knows the key can open ours in a tab, and nothing more: no hold on it.
    opened = "const w = window.open(arguments[0]); await new Promise(r => setTimeout(r, 1500)); "
    look = "try { return String(w.document.title) } catch { return w.closed } "
    rebound.driver.get(f"http://{EVIL}:{elsewhere}/")
    assert rebound.run(f"return (async () => {{ {opened} {look} }})()", page.address) is True
    assert page.counted == 0
    # the tab that it opened goes on asking for itself, as the page of its user does
    first, *others = rebound.driver.window_handles
    for tab in others:
        rebound.driver.switch_to.window(tab)
        rebound.driver.close()
    rebound.driver.switch_to.window(first)

    # The attacker's own name points here now: it is the page's origin, and still gets nothing.
    rebound.driver.get(f"http://{EVIL}:{page.port}/{knowing}/")
    assert "this page answers at" in rebound.text() and SECRET not in rebound.driver.page_source
    read = "return fetch(arguments[0], arguments[1]).then(async a => a.status + await a.text())"
    passed = list(page.passed)
    posted = {"method": "POST", "body": COUNT, "headers": {"Content-Type": "application/json"}}
    for path, options in (("state", {}), ("do", posted)):
        assert rebound.run(read, f"/{knowing}/{path}", options).startswith(
            "403mcrim app: this page"
        )
    assert (page.counted, page.passed) == (0, passed)


def test_a_page_works_under_the_policy(page, browser):
    browser.driver.get(page.address)
    assert browser.text("#secret") == SECRET
    colour = "return getComputedStyle(document.querySelector('#secret')).color"
    assert browser.run(colour) == "rgb(1, 2, 3)"
    browser.find("#count").click()
    browser.wait_for(lambda: browser.text("#said") == "counted 1", "count")
    assert browser.downloaded("table.csv").read_text() == "a,b\n"
    assert browser.complaints() == []
    asked = browser.requests()
    assert len(asked) >= 4 and all(address.startswith(page.address) for address in asked)
    # a script that somebody smuggled into the page does not run
    browser.run(
        "const s = document.createElement('script'); s.textContent = 'window.smuggled = 1';"
        "document.body.append(s); document.body.insertAdjacentHTML("
        "'beforeend', '<img src=none onerror=\"window.smuggled = 1\">')"
    )
    assert browser.wait_for(lambda: len(browser.complaints()) >= 1, "complaint")
    assert browser.run("return window.smuggled") is None
    browser.screenshot("gate")
