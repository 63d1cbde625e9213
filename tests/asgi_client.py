"""A client of the tests' own that speaks ASGI to the server, without a network or a library."""

import asyncio
import json

HOST = "127.0.0.1:4000"
ORIGIN = f"http://{HOST}"


class Answer:
    """What came back: status, headers (the last of a name), body."""

    def __init__(self, sent):
        start = next(m for m in sent if m["type"] == "http.response.start")
        self.status = start["status"]
        self.headers = {k.decode().lower(): v.decode() for k, v in start["headers"]}
        self.body = b"".join(m.get("body", b"") for m in sent if m["type"] == "http.response.body")

    @property
    def data(self):
        return json.loads(self.body)


class Client:
    """A browser with a cookie jar; ``headers`` replace its own, None takes one away."""

    def __init__(self, app, cookie=None):
        self.app = app
        self.cookie = cookie

    def own(self, headers):
        pairs = {"host": HOST, "origin": ORIGIN, "sec-fetch-site": "same-origin"}
        if self.cookie:
            pairs["cookie"] = self.cookie
        pairs.update(headers or {})
        return [(k.encode(), v.encode()) for k, v in pairs.items() if v is not None]

    async def request(self, method, path, body=b"", headers=None, more=(), query=""):
        """One request; more: further pairs of headers; body: bytes, or parts of them."""
        parts = [body] if isinstance(body, bytes) else list(body)
        scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": method,
            "path": path,
            "raw_path": path.encode(),
            "root_path": "",
            "scheme": "http",
            "query_string": query.encode(),
            "headers": [*self.own(headers), *more],
            "server": ("127.0.0.1", 4000),
            "client": ("127.0.0.1", 5000),
        }
        sent = []

        async def receive():
            if not parts:
                await asyncio.sleep(3600)  # a browser that waits for its answer
            return {"type": "http.request", "body": parts.pop(0), "more_body": bool(parts)}

        async def send(message):
            sent.append(message)

        await self.app(scope, receive, send)
        return Answer(sent)

    def ask(self, *arguments, **options):
        """``request`` from where nothing runs."""
        return asyncio.run(self.request(*arguments, **options))

    def enter(self, token):
        """Comes with the printed address and keeps the cookie."""
        answer = self.ask("GET", "/", query=f"token={token}", headers={"origin": None})
        self.cookie = answer.headers.get("set-cookie", "").split(";")[0] or None
        return answer

    async def socket(self, path, headers=None, said=(), until=None):
        """What the server sends on a socket: until(message) ends it, or the server does."""
        scope = {
            "type": "websocket",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "path": path,
            "raw_path": path.encode(),
            "root_path": "",
            "scheme": "ws",
            "query_string": b"",
            "headers": self.own(headers),
            "subprotocols": [],
            "server": ("127.0.0.1", 4000),
            "client": ("127.0.0.1", 5000),
        }
        inbox = asyncio.Queue()
        await inbox.put({"type": "websocket.connect"})
        sent, waiting = [], list(said)

        async def send(message):
            sent.append(message)
            if message["type"] == "websocket.close":
                return
            if message["type"] == "websocket.send":
                if message.get("bytes") is not None:
                    await inbox.put({"type": "websocket.receive", "text": "ok"})
                    if waiting:
                        text = waiting.pop(0)
                        kind = "bytes" if isinstance(text, bytes) else "text"
                        text = text if isinstance(text, str | bytes) else json.dumps(text)
                        await inbox.put({"type": "websocket.receive", kind: text})
                if until is not None and until(message):
                    await inbox.put({"type": "websocket.disconnect", "code": 1001})

        await self.app(scope, inbox.get, send)
        return sent
