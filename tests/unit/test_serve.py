"""The server of ``bsp-gp serve``: who gets in, what it takes, what it runs (no browser)."""

import json
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request

import pytest

from tests.snippets import ROOT, blocks, compare

for library in ("starlette", "uvicorn"):
    pytest.importorskip(library, reason="the extra [web] is not installed")

FALLS = ROOT / "examples" / "falls.csv"
WEIGHT = "9.81 [m/s^2] * m_i * down"


class Server:
    """A running ``bsp-gp serve`` and how to ask it."""

    def __init__(self, *options):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "bsp_gp", "serve", "--no-open", *options], cwd=ROOT, text=True,
            stdout=subprocess.PIPE,
        )  # fmt: skip
        self.address = self.process.stdout.readline().split()[1]
        self.port = urllib.parse.urlsplit(self.address).port

    def ask(self, path, body=None, method="POST", headers=None, address=None):
        """Status and answer, as JSON where it is."""
        data = body if isinstance(body, bytes | None) else json.dumps(body).encode()
        data = b"{}" if data is None and method == "POST" else data
        request = urllib.request.Request(
            (address or self.address) + path, data=data, method=method, headers=headers or {}
        )
        try:
            with urllib.request.urlopen(request, timeout=120) as answer:
                return answer.status, _read(answer.read())
        except urllib.error.HTTPError as error:
            return error.code, _read(error.read())

    def give(self, files):
        """Drop files, a mapping of name to bytes; the key of the data set."""
        key = self.ask("data")[1]["key"]
        for name, content in files.items():
            status, answer = self.ask(f"data/{key}/files/{name}", content, "PUT")
            assert status == 200, answer
        return key

    def ended(self, key, timeout=300):
        """The job once it ended."""
        until = time.monotonic() + timeout
        while (job := self.ask(f"jobs/{key}", method="GET")[1])["state"] in ("waiting", "running"):
            assert time.monotonic() < until
            time.sleep(0.3)
        return job

    def close(self):
        self.process.send_signal(2)
        self.process.stdout.close()
        return self.process.wait(30)


def _read(content):
    try:
        return json.loads(content)
    except ValueError:
        return content


@pytest.fixture(scope="module")
def server():
    server = Server()
    yield server
    server.close()


def test_the_command_says_what_the_page_shows():
    command, shown = blocks((ROOT / "docs" / "serve.md").read_text("utf-8"))[:2]
    server = Server(*command.text.split()[2:])
    said = f"Page: {server.address}\n{server.process.stdout.readline()}"
    assert server.ask("", method="GET")[0] == 200
    assert server.close() == 0
    compare(shown.text, said, "serve.md")


def test_without_the_token_nothing_is_to_be_had(server):
    base = f"http://127.0.0.1:{server.port}/"
    for path in ("", "data", "page.js", "wrong/data", "../", "x" * 32 + "/"):
        for method in ("GET", "POST"):
            status, answer = server.ask(path, method=method, address=base)
            assert status == 403
            assert b"token" in answer


def test_another_name_of_the_machine_is_refused(server):
    for host in ("evil.example", f"evil.example:{server.port}", "127.0.0.1", ""):
        assert server.ask("", method="GET", headers={"Host": host})[0] == 403
    assert server.ask("", method="GET", headers={"Host": f"localhost:{server.port}"})[0] == 200


def test_it_listens_on_this_machine_alone(server):
    with open("/proc/net/tcp") as file:
        rows = [line.split() for line in file.readlines()[1:]]
    port = f"{server.port:04X}"
    listening = [row[1].split(":")[0] for row in rows if row[3] == "0A" and row[1].endswith(port)]
    assert listening == ["0100007F"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:  # an address of ours, unsent
        try:
            probe.connect(("198.51.100.1", 9))
        except OSError:
            pytest.skip("this machine has no other address")
        outer = probe.getsockname()[0]
    if outer.startswith("127."):
        pytest.skip("this machine has no other address")
    with pytest.raises(OSError), socket.create_connection((outer, server.port), timeout=3):
        pass


@pytest.mark.parametrize(
    "name", ["..%2Fx.csv", "a/../../x.csv", "%2Fetc%2Fx", "-rf", "...", "a%00b"]
)
def test_a_name_that_leads_out_is_refused(server, name):
    key = server.ask("data")[1]["key"]
    status, answer = server.ask(f"data/{key}/files/{name}", b"x", "PUT")
    assert status in (400, 403, 404)
    if status == 400:
        assert "may not be called" in answer["error"]


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("empty.csv", b"", "empty"),
        ("noise.csv", bytes(range(256)) * 40, ""),
        pytest.param("zip.xlsx", b"PK\x03\x04" + b"\0" * 500, "workbook", marks=pytest.mark.slow),
        pytest.param("run.exe", b"MZ\x90\x00" * 10, "", marks=pytest.mark.slow),
    ],
)
def test_a_hostile_file_is_told_and_the_server_goes_on(server, name, content, word):
    key = server.give({name: content})
    status, answer = server.ask(f"data/{key}/check")
    assert status == 200
    assert answer["error"] and word in answer["error"]
    assert "Traceback" not in answer["error"] and "/data/" not in answer["error"]
    status, _ = server.ask(f"data/{key}/run", {"laws": [WEIGHT]})
    assert status == 400
    assert server.ask("", method="GET")[0] == 200


@pytest.mark.slow
def test_files_that_are_modules_of_python_are_not_imported(server):
    bad = b"raise SystemExit('imported')\n"
    folder = "d/trajectories.csv", "d/numpy.py", "d/bsp_gp.py", "d/sitecustomize.py"
    key = server.give({folder[0]: FALLS.read_bytes(), **dict.fromkeys(folder[1:], bad)})
    status, answer = server.ask(f"data/{key}/check")
    assert (status, answer["error"]) == (200, "")


@pytest.mark.slow
def test_laws_are_checked_at_once_with_units(server):
    key = server.give({"falls.csv": FALLS.read_bytes()})
    assert server.ask(f"data/{key}/check")[1]["error"] == ""
    laws = [WEIGHT, "9.81 * m_i * down", "-c * norm(v_i) * v_i", "import os"]
    found = server.ask(f"data/{key}/laws", {"laws": laws})[1]["laws"]
    assert found[0] == {"error": "", "constants": []}
    assert "unit kg" in found[1]["error"] and "9.81 [m/s^2]" in found[1]["error"]
    assert found[2]["constants"] == ["c [mass/m]"]
    assert found[3]["error"]
    status, answer = server.ask(f"data/{key}/run", {"laws": laws[1:2]})
    assert status == 400 and "unit kg" in answer["error"]


@pytest.mark.parametrize(
    "body", [b"[]", b"{", b'{"units": 3}', b'{"up": "--out"}', b'{"fps": "-1"}', b'{"laws": "x"}',
             b'{"columns": {"x": ["a"]}}', b"[" * 5000, b'{"time_limit": "1s --out /x"}'],
)  # fmt: skip
def test_a_request_that_is_none_is_told(server, body):
    key = server.give({"falls.csv": FALLS.read_bytes()})
    status, answer = server.ask(f"data/{key}/run", body)
    assert status == 400
    assert answer["error"]


@pytest.mark.slow
def test_the_end_leaves_nothing_behind():
    server = Server("--port", "0")
    key = server.give({"falls.csv": FALLS.read_bytes()})
    job = server.ask(f"data/{key}/run", {"laws": [WEIGHT], "time_limit": "60s"})[1]
    assert job["state"] == "waiting"
    started = time.monotonic()
    while server.ask(f"jobs/{job['key']}", method="GET")[1]["state"] == "waiting":
        assert time.monotonic() < started + 30
        time.sleep(0.1)
    assert server.close() == 0
    time.sleep(0.2)
    with pytest.raises(OSError), socket.create_connection(("127.0.0.1", server.port), timeout=3):
        pass


def test_a_port_that_is_taken_is_told():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        run = subprocess.run(
            [sys.executable, "-m", "bsp_gp", "serve", "--port", str(other.getsockname()[1])],
            capture_output=True, text=True, cwd=ROOT, timeout=60,
        )  # fmt: skip
    assert run.returncode == 2
    assert "leave --port out" in run.stderr
