"""A headless Chromium, driven over its DevTools protocol."""

import base64
import itertools
import json
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

from helpers.patience import LIMIT, wait_for

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def program() -> str | None:
    """Path of a Chromium, or None where there is none."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


# Drawing in software takes all cores: the page draws in full only when a picture is taken.
BLIND = """
for (const name of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"]) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...words) { if (window.seeing) draw.apply(this, words); };
}
"""
SEEING = "window.seeing = true; new Promise(then => requestAnimationFrame(() => requestAnimationFrame(then)))"


class Browser:
    """One page of a browser of its own. Close it."""

    def __init__(self, folder: Path, width: int = 1200, height: int = 800) -> None:
        profile = folder / "profile"
        words = [
            program(),
            "--headless=new",
            "--no-sandbox",
            "--disable-dev-shm-usage",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--no-first-run",
            "--remote-debugging-port=0",
            f"--window-size={width},{height}",
            f"--user-data-dir={profile}",
            "about:blank",
        ]
        self._child = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port = wait_for(lambda: _port(profile / "DevToolsActivePort"), "the browser did not start")
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=LIMIT) as answer:
            page = next(target for target in json.load(answer) if target["type"] == "page")
        self._socket = connect(page["webSocketDebuggerUrl"], max_size=None)
        self._numbers = itertools.count(1)
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self.call("Page.enable")
        self.call("Page.addScriptToEvaluateOnNewDocument", source=BLIND)

    def close(self) -> None:
        self._socket.close()
        self._child.terminate()
        try:
            self._child.wait(20.0)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol; returns its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=LIMIT))
            if answer.get("id") == number:
                assert "error" not in answer, answer["error"]
                return answer["result"]

    def open(self, address: str) -> None:
        self.call("Page.navigate", url=address)

    def run(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_for(self, script: str) -> Any:
        """The value of a JavaScript expression as soon as it is true."""
        return wait_for(lambda: self.run(script), f"never true in the page: {script}")

    def text(self) -> str:
        """What the page says."""
        return self.run("document.body ? document.body.innerText : ''")

    def wait_for_text(self, words: str) -> None:
        """Wait until the page says something."""
        wait_for(lambda: words in self.text(), f"the page never says '{words}'")

    def mouse(self, kind: str, place: tuple[float, float], held: bool = True) -> None:
        """kind: Moved, Pressed or Released, of the left button, at a place in pixels."""
        down = held or kind != "Moved"
        self.call(
            "Input.dispatchMouseEvent",
            type=f"mouse{kind}",
            x=place[0],
            y=place[1],
            button="left" if down else "none",
            buttons=1 if held and kind != "Released" else 0,
            clickCount=0 if kind == "Moved" else 1,
        )

    def click(self, place: tuple[float, float]) -> None:
        self.mouse("Moved", place, held=False)
        self.mouse("Pressed", place)
        self.mouse("Released", place)

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 12, pause: float = 0.03) -> None:
        """Press at a place, move to another, and keep the button down."""
        self.mouse("Moved", start, held=False)
        self.mouse("Pressed", start)
        for step in range(1, steps + 1):
            fraction = step / steps
            self.mouse("Moved", (start[0] + fraction * (end[0] - start[0]), start[1] + fraction * (end[1] - start[1])))
            time.sleep(pause)

    def picture(self, file: Path | None = None) -> bytes:
        """A screenshot as PNG."""
        self.run(SEEING)
        image = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        self.run("window.seeing = false")
        if file is not None:
            file.write_bytes(image)
        return image


def _port(file: Path) -> str:
    return file.read_text().partition("\n")[0] if file.is_file() else ""
