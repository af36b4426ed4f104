"""A headless Chromium that shows pages with WebGL, driven over a pipe: no port, no driver."""

from __future__ import annotations

import base64
import io
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import image
from numpy.typing import NDArray

# Debian's, Ubuntu's, Google's, macOS's; or whatever $CHROMIUM names.
_NAMES = (
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome"),
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
)
_FLAGS = (
    *("--headless=new", "--no-sandbox", "--hide-scrollbars", "--mute-audio", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-extensions"),
    # WebGL without a GPU; in a container /dev/shm is too small.
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
    *("--disable-dev-shm-usage", "--remote-debugging-pipe"),
)
_PATIENCE = 60.0  # for any answer [s]; software rendering on a busy machine is slow


def find_chromium() -> str | None:
    names = (os.environ.get("CHROMIUM", ""), *_NAMES)
    return next(filter(None, (shutil.which(name) for name in names if name)), None)


class Page:
    """One tab, and all that its pages complained of."""

    def __init__(self, writer: int, reader: int) -> None:
        """Opens a tab through the pipe's two ends."""
        self._writer, self._reader = writer, reader
        self._unread, self._number = b"", 0
        self._session: str | None = None
        self._is_loaded = False
        self.complaints: list[str] = []
        self.requests: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Returns the answer to a command of the DevTools protocol."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._writer, json.dumps(message).encode() + b"\0")
        while (answer := self._receive()).get("id") != self._number:
            pass
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def open(self, path: Path, width: int = 480, height: int = 360, scale: float = 1.0) -> None:
        self.call(
            "Emulation.setDeviceMetricsOverride",
            **{"width": width, "height": height, "deviceScaleFactor": scale, "mobile": False},
        )
        self._is_loaded = False
        self.call("Page.navigate", url=path.resolve().as_uri())
        while not self._is_loaded:
            self._receive()

    def evaluate(self, expression: str) -> Any:
        answer = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait_for(self, expression: str) -> None:
        end = time.monotonic() + _PATIENCE
        while not self.evaluate(f"Boolean({expression})"):
            if time.monotonic() > end:
                raise TimeoutError(f"{expression} is still false; complaints: {self.complaints}")
            time.sleep(0.05)

    def take_picture(self, selector: str = "html") -> NDArray[np.float64]:
        """Returns what an element shows, at rest: red, green, blue in [0, 1], shape (h, w, 3)."""
        end = time.monotonic() + _PATIENCE
        before, picture = self._capture(selector), self._capture(selector)
        while not np.array_equal(before, picture):
            if time.monotonic() > end:
                raise TimeoutError(f"{selector} does not come to rest")
            before, picture = picture, self._capture(selector)
        return picture

    def _capture(self, selector: str) -> NDArray[np.float64]:
        # What is not in the window is not drawn; what is, in the second frame from now on.
        element = f"document.querySelector({selector!r})"
        self.evaluate(f"{element}.scrollIntoView({{block: 'center'}})")
        frame = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        self.evaluate(f"{frame}.then(() => {frame}).then(() => true)")
        place = self.evaluate(
            f"(({{x, y, width, height}}) => ({{x: x + scrollX, y: y + scrollY, width, height}}))"
            f"({element}.getBoundingClientRect())"
        )
        answer = self.call("Page.captureScreenshot", format="png", clip={**place, "scale": 1})
        picture = image.imread(io.BytesIO(base64.b64decode(answer["data"])), format="png")
        return np.asarray(picture, dtype=float)[..., :3]

    def _receive(self) -> dict[str, Any]:
        """Returns the next message; events are noted."""
        end = time.monotonic() + _PATIENCE
        while b"\0" not in self._unread:
            ready, _, _ = select.select([self._reader], [], [], max(0.0, end - time.monotonic()))
            if not ready:
                raise TimeoutError("Chromium does not answer")
            if not (received := os.read(self._reader, 1 << 20)):
                raise RuntimeError("Chromium has ended")
            self._unread += received
        text, _, self._unread = self._unread.partition(b"\0")
        message: dict[str, Any] = json.loads(text)
        self._note(message.get("method", ""), message.get("params", {}))
        return message

    def _note(self, event: str, parameters: dict[str, Any]) -> None:
        if event == "Page.loadEventFired":
            self._is_loaded = True
        elif event == "Runtime.exceptionThrown":
            self.complaints.append(str(parameters["exceptionDetails"]))
        elif event == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "warning"):
            self.complaints.append(str([a.get("value") for a in parameters["args"]]))
        elif event == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.complaints.append(parameters["entry"]["text"])
        elif event == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])


@contextmanager
def start_browser(profile: Path) -> Iterator[Page]:
    """Yields a page of a browser with a new profile in a folder, until the block ends."""
    program = find_chromium()
    assert program is not None
    command_reader, command_writer = os.pipe()
    answer_reader, answer_writer = os.pipe()

    def connect() -> None:
        # The protocol's pipe is descriptors 3 and 4.
        reader, writer = os.dup(command_reader), os.dup(answer_writer)
        os.dup2(reader, 3)
        os.dup2(writer, 4)

    process = subprocess.Popen(
        [program, *_FLAGS, f"--user-data-dir={profile}"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        close_fds=False,
        preexec_fn=connect,
    )
    os.close(command_reader)
    os.close(answer_writer)
    try:
        yield Page(command_writer, answer_reader)
    finally:
        os.close(command_writer)
        os.close(answer_reader)
        process.terminate()
        process.wait(timeout=_PATIENCE)
