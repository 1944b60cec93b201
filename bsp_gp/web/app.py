"""The server behind the page: one token in every address, this machine alone."""

import asyncio
import contextlib
import io
import json
import re
import secrets
import shlex
import socket
import zipfile
from importlib.resources import files
from pathlib import Path

from bsp_gp.errors import BspError, DataError, MissingDependencyError, SettingsError
from bsp_gp.web import asked
from bsp_gp.web.jobs import Jobs, run, without_paths
from bsp_gp.web.store import Store

try:
    import uvicorn
    from starlette.applications import Starlette
    from starlette.concurrency import run_in_threadpool
    from starlette.requests import ClientDisconnect
    from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
    from starlette.routing import Route
except ImportError as error:
    raise MissingDependencyError(
        "the page needs the extra [web]: pip install 'bsp_gp[web]'"
    ) from error

HOST = "127.0.0.1"
CHECK_LIMIT_S = 120.0
MAX_JSON = 200_000
_OWN = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'"
)
_REPORT = (
    "sandbox allow-scripts allow-popups allow-downloads; default-src 'none'; img-src data: 'self'; "
    "style-src 'unsafe-inline'; script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
)
"""A report holds names out of the data: its page may do nothing to the one around it."""
_OPTIONS = re.compile(r"--(?:columns|units|up|fps)\b[^\n]*")
"""What a line of a check offers to whoever has a terminal."""
_TYPES = {"index.html": "text/html", "page.js": "text/javascript", "page.css": "text/css"}


class _Guard:
    """Let only those in who know the token and came by the address of this machine."""

    def __init__(self, app, token, hosts):
        self.app, self.token, self.hosts = app, token, hosts

    async def __call__(self, scope, receive, send):
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        first, _, rest = scope["path"].lstrip("/").partition("/")
        host = headers.get(b"host", b"").decode("latin-1")
        is_known = secrets.compare_digest(first.encode(), self.token.encode())
        # A page of another address could have this one's name point here (DNS rebinding).
        if not is_known or host not in self.hosts:
            answer = PlainTextResponse(
                "403: this address lacks its token; take the one that bsp-gp serve printed\n", 403
            )
            await answer(scope, receive, send)
            return
        scope = {**scope, "path": f"/{rest}", "raw_path": None}

        async def guarded(message):
            if message["type"] == "http.response.start":
                has = {name for name, _ in message["headers"]}
                message["headers"] += [
                    (name, value) for name, value in (
                        (b"content-security-policy", _OWN.encode()),
                        (b"x-content-type-options", b"nosniff"),
                        (b"referrer-policy", b"no-referrer"), (b"cache-control", b"no-store"),
                        (b"cross-origin-resource-policy", b"same-origin"),
                    ) if name not in has
                ]  # fmt: skip
            await send(message)

        await self.app(scope, receive, guarded)


async def _body(request):
    """The JSON object of a request."""
    text = b""
    async for chunk in request.stream():
        text += chunk
        if len(text) > MAX_JSON:
            raise SettingsError("the request is too long")
    try:
        found = json.loads(text or b"{}")
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise SettingsError("the request is no JSON object")
    return found


class _Pages:
    """What is answered under each address."""

    def __init__(self, folder, n_at_once):
        self.folder = Path(folder)
        self.store = Store(self.folder / "data")
        self.jobs = Jobs(self.folder / "runs", n_at_once)

    def routes(self):
        """Addresses, behind the token."""
        return [
            Route("/", self.page), Route("/{name:str}", self.page),
            Route("/data", self.new, methods=["POST"]),
            Route("/data/{key}/files/{name:path}", self.receive, methods=["PUT"]),
            Route("/data/{key}/check", self.check, methods=["POST"]),
            Route("/data/{key}/laws", self.laws, methods=["POST"]),
            Route("/data/{key}/track", self.track, methods=["POST"]),
            Route("/data/{key}/run", self.run, methods=["POST"]),
            Route("/data/{key}/{name:str}.png", self.picture),
            Route("/jobs/{key}", self.job), Route("/jobs/{key}/stop", self.stop, methods=["POST"]),
            Route("/jobs/{key}/report.zip", self.download),
            Route("/jobs/{key}/report/{name:path}", self.report),
        ]  # fmt: skip

    async def page(self, request):
        """The page itself, its script and its style."""
        name = request.path_params.get("name") or "index.html"
        if name not in _TYPES:
            return PlainTextResponse("404\n", 404)
        text = files("bsp_gp.web").joinpath("page", name).read_bytes()
        return Response(text, media_type=_TYPES[name])

    async def new(self, request):
        """Room for a data set."""
        return JSONResponse({"key": self.store.new().key})

    async def receive(self, request):
        """One file of it."""
        given = self.store[request.path_params["key"]]
        path = given.place(request.path_params["name"])
        with path.open("xb") as file:
            async for chunk in request.stream():
                given.count(len(chunk))
                file.write(chunk)
        return JSONResponse({})

    async def check(self, request):
        """What is understood of it, and its columns as they stand."""
        given = self.store[request.path_params["key"]]
        options = asked.data_options(await _body(request))
        given.looks += 1
        look = given.looks
        async with given.looking:
            if look < given.looks:  # another one was asked for meanwhile
                return JSONResponse({"is_late": True})
            return JSONResponse(await self._check(given, options))

    async def _check(self, given, options):
        if given.glimpse is None:
            given.glimpse = await self._glimpse(given)
        answer = {"is_film": given.is_film, "glimpse": given.glimpse, "error": ""}
        if given.is_film and not given.tracked.is_dir():
            return answer
        words = ["check", "--overwrite", "--out", str(given.folder / "check")]
        code, out, said = await run(
            (*words, *asked.data_words(options), "--", str(given.data)), given.folder,
            time_limit=CHECK_LIMIT_S,
        )  # fmt: skip
        lines = out.splitlines()[:-1] if code == 0 else []  # the last one says where the picture is
        text, error = (without_paths(t, self.folder) for t in ("\n".join(lines), said))
        answer["text"] = _OPTIONS.sub("the choices above", text)
        answer["error"] = _OPTIONS.sub("the choices above", error) if code else ""
        if code == 0:
            await run_in_threadpool(given.dataset, options)
        return answer

    async def _glimpse(self, given):
        """Headings of a table, or the first frame of a film; None of a table that has none."""
        path = given.path
        code, seen, said = await run(
            (str(path), str(given.folder / "frame.png")), given.folder, module="bsp_gp.web.glimpse",
            time_limit=CHECK_LIMIT_S,
        )  # fmt: skip
        if code and given.is_film:
            raise DataError(without_paths(said, self.folder))
        return None if code else json.loads(seen)

    async def laws(self, request):
        """Whether each law is a force of these data, and its constants with their units."""
        given = self.store[request.path_params["key"]]
        body = await _body(request)
        dataset = await run_in_threadpool(given.dataset, asked.data_options(body))
        checked = [_checked(dataset, law) for law in asked.laws_of(body)]
        return JSONResponse({"laws": checked})

    async def track(self, request):
        """Follow an object of a film; the data set is then what was tracked."""
        given = self.store[request.path_params["key"]]
        words = asked.track_words(await _body(request))
        job = self.jobs.start([*words, "--overwrite"], given.path, given.tracked)
        return JSONResponse(job.to_dict())

    async def run(self, request):
        """Close the loop."""
        given = self.store[request.path_params["key"]]
        body = await _body(request)
        options = asked.data_options(body)
        words = asked.run_words(body, options)
        dataset = await run_in_threadpool(given.dataset, options)
        for law in asked.laws_of(body):
            if complaint := _checked(dataset, law)["error"]:
                raise SettingsError(complaint)
        job = self.jobs.start(words, given.data)
        name = given.path.name
        command = shlex.join(["bsp-gp", words[0], name, *words[1:]])
        return JSONResponse({**job.to_dict(), "command": command, "name": name})

    def _job(self, request):
        job = self.jobs.jobs.get(request.path_params["key"])
        if job is None:
            raise SettingsError("there is no such run")
        return job

    async def job(self, request):
        """How far a command is."""
        return JSONResponse(self._job(request).to_dict())

    async def stop(self, request):
        """End a command."""
        job = self._job(request)
        self.jobs.stop(job)
        return JSONResponse(job.to_dict())

    async def picture(self, request):
        """The picture of a check, or the first frame of a film."""
        given = self.store[request.path_params["key"]]
        name = request.path_params["name"]
        places = {"frame": given.folder / "frame.png", "check": given.folder / "check/picture.png"}
        if name not in places or not places[name].is_file():
            return PlainTextResponse("404\n", 404)
        return FileResponse(places[name])

    async def report(self, request):
        """A file of a report."""
        folder = (self._job(request).folder / "report").resolve()
        path = (folder / request.path_params["name"]).resolve()
        if not path.is_relative_to(folder) or not path.is_file():
            return PlainTextResponse("404\n", 404)
        return FileResponse(path, headers={"content-security-policy": _REPORT})

    async def download(self, request):
        """A whole report, as one file."""
        folder = self._job(request).folder / "report"
        if not folder.is_dir():
            return PlainTextResponse("404\n", 404)
        content = await run_in_threadpool(_zipped, folder)
        headers = {"content-disposition": 'attachment; filename="bsp-gp-report.zip"'}
        return Response(content, media_type="application/zip", headers=headers)


def _checked(dataset, law):
    """A law as the page shows it: its constants with units, or what is wrong."""
    from bsp_gp.fitting.hypothesis import read_law

    try:
        read = read_law(dataset, [law])
    except BspError as error:
        return {"error": str(error), "constants": []}
    units = read.constant_units
    told = [f"{n} [{dataset.units.text(units[n])}]" if n in units else n for n in read.names]
    return {"error": "", "constants": told}


def _zipped(folder):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file() and not path.name.startswith(".bsp_gp"):
                archive.write(path, Path("report") / path.relative_to(folder))
    return out.getvalue()


def make_app(folder, token, hosts, n_at_once=1):
    """The application: routes behind a token.

    Parameters
    ----------
    folder : path-like
        Ours alone, for what is dropped and what comes of it.
    token : str
        First part of every address.
    hosts : collection of str
        Names under which it may be asked, as "127.0.0.1:8000".
    n_at_once : int
        Commands that run at the same time.
    """
    pages = _Pages(folder, n_at_once)

    async def complaint(request, error):
        return JSONResponse({"error": without_paths(str(error), pages.folder)}, 400)

    async def gone(request, error):
        return PlainTextResponse("", 400)

    @contextlib.asynccontextmanager
    async def lifespan(app):
        yield
        await pages.jobs.close()

    app = Starlette(
        routes=pages.routes(), lifespan=lifespan,
        exception_handlers={BspError: complaint, OSError: complaint, ClientDisconnect: gone},
    )  # fmt: skip
    return _Guard(app, token, hosts)


def serve(folder, port=0, n_at_once=1, tell=None):
    """Serve the page on this machine alone until interrupted.

    The port 0 is any that is free; `tell` is given the address once the server listens.

    Raises
    ------
    SettingsError
        If the port is taken.
    """
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        try:
            listener.bind((HOST, port))
        except OSError as error:
            raise SettingsError(
                f"the port {port} cannot be taken ({error.strerror}); leave --port out"
            ) from None
        port = listener.getsockname()[1]
        token = secrets.token_urlsafe(24)
        hosts = (f"{HOST}:{port}", f"localhost:{port}")
        app = make_app(folder, token, hosts, n_at_once)
        config = uvicorn.Config(
            app, log_level="warning", access_log=False, server_header=False, lifespan="on",
            timeout_graceful_shutdown=5, ws="none",
        )  # fmt: skip
        server = uvicorn.Server(config)
        listener.listen(64)
        if tell is not None:
            tell(f"http://{HOST}:{port}/{token}/")
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(server.serve(sockets=[listener]))
    finally:
        listener.close()
