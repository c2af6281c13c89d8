"""A headless Chromium that opens one page and takes its picture, driven through two pipes.

The DevTools protocol is JSON with a zero byte after each message, on the descriptors 3 and 4.
"""

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from typing import Any

FLAGS = (
    "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--disable-dev-shm-usage",
    "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--hide-scrollbars",
    # nothing is fetched from anywhere else
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE localhost, EXCLUDE 127.0.0.1",
)  # fmt: skip


def find() -> str | None:
    """Chromium's program."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


class Browser:
    """A page; a context manager."""

    def __init__(self, width: int, height: int, *, dark: bool = False) -> None:
        self._size, self._dark = (width, height), dark
        self._number, self._session = 0, ""
        self._heard = b""

    def __enter__(self) -> "Browser":
        program = find()
        assert program is not None, "Chromium is not installed"
        self._home = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        their_in, self._out = os.pipe()
        self._in, their_out = os.pipe()

        def plug() -> None:  # in the child: descriptors 3 and 4, out of each other's way first
            a, b = os.dup2(their_in, 40), os.dup2(their_out, 41)
            os.dup2(a, 3)
            os.dup2(b, 4)

        self._process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={self._home.name}", "--remote-debugging-pipe"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, close_fds=False,
            preexec_fn=plug, start_new_session=True,
        )  # fmt: skip
        os.close(their_in)
        os.close(their_out)
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        width, height = self._size
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=False)  # fmt: skip
        look = {"name": "prefers-color-scheme", "value": "dark" if self._dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[look])
        return self

    def __exit__(self, *trouble: object) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._in)
        os.close(self._out)
        self._home.cleanup()

    def call(self, method: str, patience: float = 180.0, **params: Any) -> dict[str, Any]:
        """Send a command and return its answer."""
        self._number += 1
        words: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session:
            words["sessionId"] = self._session
        os.write(self._out, json.dumps(words).encode() + b"\0")
        until = time.monotonic() + patience
        while True:
            message, zero, rest = self._heard.partition(b"\0")
            if zero:
                self._heard = rest
                answer = json.loads(message)
                if answer.get("id") == self._number:
                    if "error" in answer:  # for instance in the middle of a navigation
                        raise ConnectionError(answer["error"]["message"])
                    return answer["result"]
                continue
            left = until - time.monotonic()
            if left <= 0.0 or not select.select([self._in], [], [], left)[0]:
                raise TimeoutError(f"no answer to {method} in {patience:g} s")
            self._heard += os.read(self._in, 1 << 16)

    def open(self, url: str) -> None:
        """Go there."""
        self.call("Page.enable")
        self.call("Page.navigate", url=url)

    def value(self, script: str) -> Any:
        """Value of an expression on the page."""
        return self.call("Runtime.evaluate", expression=script, returnByValue=True,
                         awaitPromise=True)["result"].get("value")  # fmt: skip

    def picture(self, *, whole: bool = False) -> bytes:
        """PNG of the window, or of the whole page."""
        answer = self.call("Page.captureScreenshot", patience=120.0, format="png",
                           captureBeyondViewport=whole)  # fmt: skip
        return base64.b64decode(answer["data"])
