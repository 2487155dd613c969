"""A headless Chromium for tests, driven by its own debugging protocol."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
)
QUIET = ("ReadPixels", "GL Driver Message")
"""Messages of the console that tell of the renderer alone."""


class Page:
    """A page in the browser.

    Attributes:
        errors: Exceptions and error messages of its console so far.
    """

    def __init__(self, socket: Any) -> None:
        self._socket, self._count = socket, 0
        self.errors: list[str] = []
        for domain in ("Runtime", "Log", "Page"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Calls a method of the debugging protocol and waits for its answer."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=60))
            if message.get("id") == self._count:
                assert "error" not in message, message
                return message["result"]
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        method, body = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = body["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Runtime.consoleAPICalled" and body["type"] == "error":
            self.errors.append(" ".join(str(a.get("value", a.get("description"))) for a in body["args"]))
        elif method == "Log.entryAdded" and body["entry"]["level"] == "error":
            text = body["entry"]["text"]
            if not any(word in text for word in QUIET):
                self.errors.append(text)

    def open(self, address: str | Path) -> None:
        """Opens an address or a file, and waits until what Meshcat shows is there."""
        url = address.resolve().as_uri() if isinstance(address, Path) else address
        self.call("Page.navigate", url=url)

    def eval(self, script: str) -> Any:
        """The value of a JavaScript expression, awaited where it is a promise."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_for(self, script: str, seconds: float = 20.0) -> Any:
        """Waits until an expression is true; returns its value."""
        end = time.monotonic() + seconds
        while True:
            value = self.eval(f"(() => {{ try {{ return {script}; }} catch (error) {{ return null; }} }})()")
            if value:
                return value
            assert time.monotonic() < end, f"waited {seconds:g} s for {script}; console: {self.errors}"
            time.sleep(0.1)

    def resize(self, width: int, height: int) -> None:
        """Gives the window a size."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )

    def screenshot(self) -> bytes:
        """What is seen, as a PNG file."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])


@contextmanager
def browser() -> Iterator[Page]:
    """A page in a headless Chromium of its own; skips the test where there is none."""
    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip("needs chromium")
    client = pytest.importorskip("websockets.sync.client")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={folder}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            file, end = Path(folder) / "DevToolsActivePort", time.monotonic() + 30.0
            while not (file.is_file() and len(file.read_text().split()) == 2):
                if time.monotonic() > end or process.poll() is not None:
                    pytest.skip("chromium does not start here")
                time.sleep(0.05)
            port, path = file.read_text().split()
            with client.connect(f"ws://127.0.0.1:{port}{path}", max_size=None) as root:
                root.send(json.dumps({"id": 1, "method": "Target.createTarget", "params": {"url": "about:blank"}}))
                target = json.loads(root.recv(timeout=30))["result"]["targetId"]
                with client.connect(f"ws://127.0.0.1:{port}/devtools/page/{target}", max_size=None) as socket:
                    yield Page(socket)
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(10.0)
            process.kill()
