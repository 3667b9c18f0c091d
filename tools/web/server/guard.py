"""Who may ask the page for what, and how large answers are sent: the rules that a request passes before the page's own code.

Only GET and HEAD; a Host that is one of ours (DNS rebinding); nothing for other sites' scripts; the token, as
``Authorization`` or as the cookie that ``/api/v1/login`` gave for it; headers that let the page load nothing but its own
files. The rules are plain functions of the request and the time; ``Guard`` is their ASGI middleware. Answers of megabytes are
sent a few at a time, in parts, so that readers who take nothing cannot fill the memory.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import logging
import secrets
from collections import OrderedDict, deque
from collections.abc import Callable, Collection
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import Self

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from pdgw.base.files import read_file
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.web import WebConfig
from pdgw.tools.web.server.server import Places, sender

log = logging.getLogger("gateway")

AT_ONCE = 3
PART = 64 * 1024
"""Bytes handed to the connection before it reports that they are read."""
_ROOM_WITHIN_S = 15.0
"""Longer than a reader may take nothing (``server.READ_WITHIN_S``): the room of one that hangs is free by then."""


class LargeAnswers:
    """Makes large answers on threads, while there is room."""

    def __init__(self) -> None:
        self._room = asyncio.Semaphore(AT_ONCE)

    def __call__(self, make: Callable[[], Response]) -> ASGIApp:
        """An answer that ``make`` computes when it is its turn."""

        async def answer(scope: Scope, receive: Receive, send: Send) -> None:
            try:
                async with asyncio.timeout(_ROOM_WITHIN_S):
                    await self._room.acquire()
            except TimeoutError:
                await refusal(503, "too many large answers at once", "request", retry_after="5")(scope, receive, send)
                return
            try:
                await _send(await run_in_threadpool(make), send)
            finally:
                self._room.release()

        return answer


async def _send(response: Response, send: Send) -> None:
    await send({"type": "http.response.start", "status": response.status_code, "headers": response.raw_headers})
    body = bytes(response.body)
    for begin in range(0, len(body), PART):
        await send({"type": "http.response.body", "body": body[begin : begin + PART], "more_body": True})
    await send({"type": "http.response.body", "body": b""})


COOKIE = "pdgw_session"
LOGIN_PATH = "/api/v1/login"
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
        "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}
FAILURES_MAX = 5
FAILURES_WITHIN_S = 60.0
_ADDRESSES_MAX = 256
"""Number of the latest addresses with wrong tokens."""
_TOKEN_MIN, _TOKEN_MAX = 16, 4096
_SEALED = ("/api/", "/metrics")
"""Paths that need the token. The page's own files and the health answers contain no data of the plant."""
_LOCAL_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]"})


def read_token(path: Path) -> str:
    """The token of a file, without the white space around it; GatewayError when it cannot be read or is too short to be one."""
    try:
        token = read_file(path, _TOKEN_MAX).decode().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise GatewayError(f"token_file {path}: cannot be read ({error})") from error
    if not _TOKEN_MIN <= len(token) <= _TOKEN_MAX or not token.isascii() or not token.isprintable():
        raise GatewayError(
            f"token_file {path}: expected {_TOKEN_MIN} to {_TOKEN_MAX} printable ASCII characters, for example "
            "the output of `openssl rand -hex 32`"
        )
    return token


def _version(file: Path | None) -> tuple[int, ...]:
    """Another one for another content of a file; empty without one."""
    try:
        found = None if file is None else file.stat()
    except OSError:
        found = None
    return () if found is None else (found.st_mtime_ns, found.st_ino, found.st_size)


def allowed_hosts(config: WebConfig) -> frozenset[str]:
    """The names a request may have in its Host header, lower case and without port."""
    host = config.address[0]
    own = f"[{host}]" if ":" in host else host
    return frozenset({*(name.lower() for name in config.hosts), own, *(_LOCAL_NAMES if config.is_local else ())})


def host_name(header: str) -> str:
    """The name of a Host header without its port."""
    name, colon, port = header.lower().rpartition(":")
    return name if colon and port.isdecimal() else header.lower()


class Failures:
    """Wrong tokens of each sender."""

    def __init__(self) -> None:
        self._times: OrderedDict[str, deque[float]] = OrderedDict()

    def wait_s(self, address: str, now: float) -> float:
        """Seconds until a wrong token is answered by 401 again; 0: now. ``now``: monotonic seconds."""
        times = self._times.get(address)
        if times is None or len(times) < FAILURES_MAX:
            return 0.0
        return max(0.0, times[0] + FAILURES_WITHIN_S - now)

    def count(self, address: str, now: float) -> None:
        """Another one."""
        times = self._times.setdefault(address, deque(maxlen=FAILURES_MAX))
        times.append(now)
        self._times.move_to_end(address)
        while len(self._times) > _ADDRESSES_MAX:
            self._times.popitem(last=False)


class Token:
    """The secret of a ``file``, compared in constant time; what is kept of it and handed out cannot be turned back into it."""

    def __init__(self, token: str, file: Path | None = None) -> None:
        self._file = file
        self._read = _version(file)
        self._set(token)

    @classmethod
    def of(cls, file: Path) -> Self:
        """That of a file; GatewayError when it has none."""
        return cls(read_token(file), file)

    def _set(self, token: str) -> None:
        self._digest = hashlib.sha256(token.encode()).digest()
        self.session = hmac.new(token.encode(), b"session of pdgw web", hashlib.sha256).hexdigest()
        """The value of the cookie. It is derived from the token: another token ends all sessions."""

    def refresh(self) -> bool:
        """Read the file again if it has changed; True: all sessions have ended. Without a token in it nothing opens the page."""
        version = _version(self._file)
        if self._file is None or version == self._read:
            return False
        self._read, before = version, self.session
        try:
            self._set(read_token(self._file))
        except GatewayError as error:
            log.error("%s; until then the page is locked", error)
            self._set(secrets.token_hex())
        if self.session == before:
            return False
        log.info("token_file %s has changed: all sessions have ended", self._file)
        return True

    def opens(self, authorization: str) -> bool:
        """An ``Authorization: Bearer`` header with the token."""
        kind, _, given = authorization.partition(" ")
        digest = hashlib.sha256(given.strip().encode("latin-1", "replace")).digest()
        return hmac.compare_digest(digest, self._digest) and kind.lower() == "bearer"

    def shown(self, headers: Headers) -> bool:
        """Whether the request has the token or the cookie."""
        given = headers.get("authorization")
        return self.is_session(headers.get("cookie", "")) if given is None else self.opens(given)

    def is_session(self, cookies: str) -> bool:
        """Whether a ``Cookie`` header belongs to a logged-in user."""
        try:
            given = SimpleCookie(cookies).get(COOKIE)
        except CookieError:
            return False
        return given is not None and hmac.compare_digest(given.value.encode(), self.session.encode())


def refusal(status: int, text: str, field: str, **headers: str) -> Response:
    """An error in the format of the interface."""
    return JSONResponse({"error": text, "field": field}, status, {k.replace("_", "-"): v for k, v in headers.items()})


class Guard:
    """ASGI middleware with these rules; ``now`` is monotonic seconds."""

    def __init__(
        self,
        app: ASGIApp,
        hosts: Collection[str],
        token: Token | None,
        places: Places,
        now: Callable[[], float],
        *,
        secure: bool,
    ) -> None:
        self._app = app
        self._hosts = hosts
        self._token = token
        self._places = places
        self._now = now
        self._secure = secure
        self._failures = Failures()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        peer = scope.get("client") or ("", 0)
        given = Headers(scope=scope)

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(HEADERS)
                if not self._places.keeps(peer):
                    headers["connection"] = "close"
                headers.setdefault("cache-control", "no-store")
            await send(message)

        answer = self.answer(scope["method"], scope["path"], given, peer[0])
        if self._token is not None and self._token.shown(given):
            self._places.keep(peer)
        await (self._app if answer is None else answer)(scope, receive, send_guarded)

    def answer(self, method: str, path: str, headers: Headers, address: str) -> Response | None:
        """The answer in place of the requested one; None: the request may continue."""
        if method not in {"GET", "HEAD"}:
            return refusal(405, "this page is read-only: GET and HEAD only", "method", allow="GET, HEAD")
        if host_name(headers.get("host", "")) not in self._hosts:
            allowed = ", ".join(sorted(self._hosts))
            return refusal(421, f"not a name of this page; allowed: {allowed}; add names with [web] hosts", "host")
        sealed = path.startswith(_SEALED)
        if sealed and headers.get("sec-fetch-site", "none") not in {"none", "same-origin"}:
            return refusal(403, "the request comes from another site", "sec-fetch-site")
        if self._token is None:
            return Response(status_code=204) if path == LOGIN_PATH else None
        return self._checked(self._token, path, headers, address) if sealed else None

    def _checked(self, token: Token, path: str, headers: Headers, address: str) -> Response | None:
        given = headers.get("authorization")
        if given is None:
            if path != LOGIN_PATH and token.is_session(headers.get("cookie", "")):
                return None
            return refusal(401, "the token is missing", "authorization", www_authenticate="Bearer")
        if not token.opens(given):
            return self._wrong(sender(address))
        if path != LOGIN_PATH:
            return None
        done = Response(status_code=204)
        done.set_cookie(COOKIE, token.session, path="/", secure=self._secure, httponly=True, samesite="strict")
        return done

    def _wrong(self, name: str) -> Response:
        now = self._now()
        wait = self._failures.wait_s(name, now)
        if wait:
            return refusal(
                429, "too many wrong tokens, try again later", "authorization", retry_after=str(int(wait) + 1)
            )
        self._failures.count(name, now)
        return refusal(401, "wrong token", "authorization", www_authenticate="Bearer")
