"""A page in headless Chromium, over the DevTools protocol on two pipes: no driver, no port, no
further package.
"""

import base64
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))),
    None,
)
QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-dev-shm-usage",
)
START = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]
os.dup2(ends[0], 3), os.dup2(ends[1], 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""The browser takes commands on its descriptor 3 and answers on 4."""
PATIENCE = 300.0
"""Seconds that an answer may take; two cores with other work on them are slow."""


class Browser:
    """One browser with one tab. `errors` gathers what the console would show in red, `asked` every
    address that was fetched.
    """

    def __init__(self, profile: Path) -> None:
        down, up = os.pipe(), os.pipe()
        options = [*QUIET, "--remote-debugging-pipe", f"--user-data-dir={profile}", "about:blank"]
        self.process = subprocess.Popen(
            [sys.executable, "-c", START, str(down[0]), str(up[1]), str(CHROMIUM), *options],
            pass_fds=(down[0], up[1]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(down[0]), os.close(up[1])
        self.down, self.up = os.fdopen(down[1], "wb", 0), os.fdopen(up[0], "rb", 0)
        os.set_blocking(up[0], False)
        self.count, self.rest, self.session = 0, b"", None
        self.errors: list[str] = []
        self.asked: list[str] = []
        target = self.tell("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.tell("Target.attachToTarget", targetId=target, flatten=True)[
            "sessionId"
        ]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.tell(f"{domain}.enable")

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_) -> None:
        self.down.close()
        self.process.terminate()
        self.process.wait(20)
        self.up.close()

    def tell(self, method: str, **parameters):
        """The answer to one command."""
        self.count += 1
        message = {"id": self.count, "method": method, "params": parameters}
        message |= {"sessionId": self.session} if self.session else {}
        self.down.write(json.dumps(message).encode() + b"\0")
        limit = time.monotonic() + PATIENCE
        while time.monotonic() < limit:
            for found in self._messages():
                if found.get("id") == self.count:
                    assert "error" not in found, found["error"]
                    return found["result"]
        raise TimeoutError(method)

    def _messages(self):
        got = self.up.read(1 << 20)
        if not got:
            assert self.process.poll() is None, "the browser ended"
            time.sleep(0.02)
            return
        *whole, self.rest = (self.rest + got).split(b"\0")
        yield from [found for text in whole if (found := self._note(json.loads(text))) is not None]

    def _note(self, message: dict) -> dict | None:
        given = message.get("params", {})
        match message.get("method"):
            case "Runtime.exceptionThrown":
                self.errors.append(json.dumps(given["exceptionDetails"])[:800])
            case "Runtime.consoleAPICalled" if given["type"] in ("error", "assert", "warning"):
                self.errors.append(json.dumps(given["args"])[:800])
            case "Log.entryAdded" if given["entry"]["level"] == "error":
                self.errors.append(given["entry"]["text"])
            case "Network.requestWillBeSent":
                self.asked.append(given["request"]["url"][:100])
        return message

    def run(self, script: str):
        """The value of an expression in the page."""
        found = self.tell(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def show(self, page: Path, width: int = 1200, height: int = 900, dark: bool = False) -> None:
        """Open a file at a width and in a colour scheme, and wait until its plots are drawn."""
        self.errors, self.asked = [], []
        self.tell(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        self.scheme(dark)
        self.tell("Page.navigate", url=page.resolve().as_uri())
        self.until("document.readyState === 'complete'")
        self.until(
            "!document.querySelector('.explore') || document.documentElement.dataset.plots === "
            "'drawn'"
        )

    def scheme(self, dark: bool) -> None:
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.tell("Emulation.setEmulatedMedia", features=features)

    def until(self, script: str) -> None:
        limit = time.monotonic() + PATIENCE
        while not self.run(f"!!({script})"):
            assert time.monotonic() < limit and not self.errors, (script, self.errors)
            time.sleep(0.05)

    def picture(self, path: Path, whole: bool = True) -> Path:
        """A PNG of the page, for looking at."""
        taken = self.tell("Page.captureScreenshot", captureBeyondViewport=whole, format="png")
        path.write_bytes(base64.b64decode(taken["data"]))
        return path
