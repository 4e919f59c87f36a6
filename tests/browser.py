"""A browser without a window, driven over pipes by its own protocol; no driver, no package."""

from __future__ import annotations

import base64
import fcntl
import json
import os
import shutil
import subprocess
import sys
from select import select
from time import monotonic

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run",
    "--disable-background-networking", "--disable-dev-shm-usage", "--remote-debugging-pipe",
)  # fmt: skip
_EXEC = """
import os, sys
os.dup2(int(sys.argv[1]), 3)
os.dup2(int(sys.argv[2]), 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
_SECONDS = 60.0


def find():
    """Path of a browser, or nothing."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Page:
    """A page of a browser of its own."""

    def __init__(self, program, profile):
        theirs_in, ours_out = os.pipe()
        ours_in, theirs_out = os.pipe()
        ends = [fcntl.fcntl(each, fcntl.F_DUPFD, 10) for each in (theirs_in, theirs_out)]
        command = [sys.executable, "-c", _EXEC, *map(str, ends), program, *_OPTIONS]
        self.process = subprocess.Popen(
            [*command, f"--user-data-dir={profile}", "about:blank"],
            pass_fds=ends,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for each in (theirs_in, theirs_out, *ends):
            os.close(each)
        self._in, self._out, self._rest, self._number = ours_in, ours_out, b"", 0
        self._session = None
        self.events = []
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        attached = self.send("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self._in)
        os.close(self._out)

    def send(self, method, **params):
        """Call a method of the protocol and wait for what it gives."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, (method, answer)
                return answer["result"]
            self.events.append(answer)

    def _next(self):
        until = monotonic() + _SECONDS
        while b"\0" not in self._rest:
            assert select([self._in], [], [], max(0, until - monotonic()))[0], "no answer in time"
            data = os.read(self._in, 1 << 20)
            assert data, "the browser ended"
            self._rest += data
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)

    def open(self, path):
        """Open a file; give the seconds until its scripts ran and its first pictures are there."""
        start = monotonic()
        self.events.clear()
        self.send("Page.navigate", url=path.as_uri())
        while not any(each.get("method") == "Page.loadEventFired" for each in self.events):
            self.events.append(self._next())
        self.value(
            "Promise.all([...document.images].slice(0, 12).map((each) => each.decode()))"
            ".then(() => new Promise((done) => requestAnimationFrame(() => setTimeout(done))))"
        )
        return monotonic() - start

    def value(self, expression):
        """Evaluate an expression of the page; promises are waited for."""
        answer = self.send(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def complaints(self):
        """What the console was told, exceptions, and requests for anything but the page."""
        found = []
        for each in self.events:
            method, params = each.get("method"), each.get("params", {})
            if method in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
                found.append(params)
            elif method == "Network.requestWillBeSent":
                url = params["request"]["url"]
                if not url.startswith(("data:", "file:")):
                    found.append(url)
        return found

    def press(self, key, text=None, *, shift=False):
        """Press and let go a key."""
        codes = {
            "Tab": 9, "Enter": 13, " ": 32, "ArrowDown": 40, "ArrowUp": 38, "Home": 36, "End": 35,
        }  # fmt: skip
        known = {"key": key, "windowsVirtualKeyCode": codes.get(key) or ord(key.upper())}
        text = {"Enter": "\r", " ": " "}.get(key, text)
        down = {**known, "modifiers": 8 * shift, **({"text": text} if text else {})}
        self.send("Input.dispatchKeyEvent", type="keyDown" if text else "rawKeyDown", **down)
        self.send("Input.dispatchKeyEvent", type="keyUp", **known)

    def type(self, text):
        """Type letters and digits."""
        for each in text:
            self.press(each, each)

    def tab_to(self, test):
        """Press the tabulator until the focused element fits; as a user without a mouse does."""
        for _ in range(200):
            self.press("Tab")
            if self.value(f"((e) => !!({test}))(document.activeElement)"):
                return
        raise AssertionError(f"the tabulator does not get to {test}")

    def look(self, *, width=1280, height=1000, dark=False, media="screen"):
        """Set the size of the window and the user's preferences."""
        self.send(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=width < 600,
        )  # fmt: skip
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.send("Emulation.setEmulatedMedia", media=media, features=[scheme])

    def screenshot(self):
        """PNG file of what is seen."""
        return base64.b64decode(self.send("Page.captureScreenshot")["data"])
