"""A headless Chromium, driven over its DevTools protocol."""

import base64
import itertools
import json
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--disable-extensions",
    "--no-first-run",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--remote-debugging-port=0",
    "--window-size=1500,950",
)
# Where the middle of what has a label is, if a press there would reach it.
_PLACE = """
    label => {
        const named = selector => [...document.querySelectorAll(selector)].filter(
            each => each.innerText && each.innerText.trim() === label && each.offsetParent !== null);
        // A folder's heading is none of these: the innermost of what has its words.
        const found = named('button, label, [role=tab]')[0] || named('body *').at(-1);
        if (!found) return null;
        found.scrollIntoView({block: 'center', behavior: 'instant'});
        const box = found.getBoundingClientRect();
        const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
        const top = document.elementFromPoint(x, y);
        return top && (found.contains(top) || top.contains(found)) ? [x, y] : null;
    }
"""

# The given one of the fields beside a label, if it is shown.
_FIELD = """
    (label, index) => {
        const named = [...document.querySelectorAll('body *')].filter(
            each => each.innerText && each.innerText.trim() === label && each.offsetParent !== null).at(-1);
        let around = named;
        while (around && !around.querySelector('input')) around = around.parentElement;
        return around ? [...around.querySelectorAll('input')].filter(each => each.type !== 'hidden')[index] : null;
    }
"""
_SELECT = f"""
    (label, index) => {{
        const field = ({_FIELD})(label, index);
        if (!field) return false;
        field.scrollIntoView({{block: 'center', behavior: 'instant'}});
        field.focus();
        field.select();
        return document.activeElement === field;
    }}
"""
_VALUE = f"(label, index) => {{ const field = ({_FIELD})(label, index); return field ? field.value : null; }}"


def find_chromium() -> str:
    """Path of the browser; skips the test, saying what to install, where there is none."""
    for name in _NAMES:
        path = shutil.which(name)
        if path is not None:
            return path
    pytest.skip("no Chromium on PATH; on Debian: apt-get install chromium")


class Chromium:
    """One browser process; ``open`` gives a page."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True)
        words = [find_chromium(), *_OPTIONS, f"--user-data-dir={self._folder.name}", "about:blank"]
        self.process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, encoding="utf-8")
        assert self.process.stderr is not None
        for line in self.process.stderr:
            found = re.search(r"DevTools listening on (ws://\S+)", line)
            if found:
                self._address = found[1]
                break
        else:
            raise RuntimeError("the browser did not start")

    def open(self, url: str) -> "Page":
        return Page(self._address, url)

    def kill(self) -> None:
        """As if it had crashed."""
        self.process.kill()
        self.process.wait()

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        if self.process.stderr is not None:
            self.process.stderr.close()
        self._folder.cleanup()


class Page:
    """A tab. Calls wait for the browser's answer."""

    def __init__(self, address: str, url: str):
        self._socket: ClientConnection = connect(address, max_size=None, compression=None, open_timeout=60)
        self._ids = itertools.count(1)
        self._session: str | None = None
        self.requests: list[str] = []
        """Addresses the page has asked for."""
        self._target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=self._target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network"):
            self.call(f"{domain}.enable")
        self.call("Emulation.setDeviceMetricsOverride", width=1500, height=950, deviceScaleFactor=1, mobile=False)
        self.call("Page.bringToFront")
        self.call("Page.navigate", url=url)
        deadline = time.monotonic() + 60.0
        while not self.evaluate("location.href !== 'about:blank' && document.readyState === 'complete'"):
            assert time.monotonic() < deadline, f"{url} does not load"
            time.sleep(0.1)

    def call(self, method: str, **arguments: object) -> dict[str, Any]:
        number = next(self._ids)
        message: dict[str, object] = {"id": number, "method": method, "params": arguments}
        if self._session is not None:
            message["sessionId"] = self._session
        self._socket.send(json.dumps(message))
        while True:
            answer = json.loads(self._socket.recv(timeout=120))
            if answer.get("method") == "Network.requestWillBeSent":
                self.requests.append(answer["params"]["request"]["url"])
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]

    def evaluate(self, script: str) -> Any:
        result = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in result:
            raise RuntimeError(f"{script}: {result['exceptionDetails']}")
        return result["result"].get("value")

    def text(self) -> str:
        return self.evaluate("document.body ? document.body.innerText : ''")

    def wait_for(self, words: str, seconds: float = 90.0) -> None:
        """Until the page's text has ``words``."""
        deadline = time.monotonic() + seconds
        while words not in self.text():
            assert time.monotonic() < deadline, f"{words!r} is not in the page:\n{self.text()}"
            time.sleep(0.2)

    def click(self, label: str, seconds: float = 90.0) -> None:
        """Press the button, tab or checkbox with this label, as a mouse does, once it is there and at rest."""
        deadline = time.monotonic() + seconds
        place, before = None, None
        while place is None or place != before:
            assert time.monotonic() < deadline, f"nothing that can be pressed is labelled {label!r}:\n{self.text()}"
            time.sleep(0.2)
            before, place = place, self.evaluate(f"({_PLACE})({json.dumps(label)})")
        self.press(*place)

    def unfold(self, heading: str, label: str, seconds: float = 90.0) -> None:
        """Open the folder with this heading, which then shows the label, at rest.

        A busy page may still be about to open the folder above, and then the press meets what comes to lie there; it
        may also be long in opening this one, and a second press would shut it.
        """
        deadline = time.monotonic() + seconds
        while not self._rests(label):
            assert time.monotonic() < deadline, f"{heading!r} does not open and show {label!r}:\n{self.text()}"
            if label in self.text():
                continue
            self.click(heading)
            pressed = time.monotonic()
            while label not in self.text() and time.monotonic() < pressed + 15.0:
                time.sleep(0.2)

    def _rests(self, label: str) -> bool:
        """Whether what has this label is shown and stays where it is for a second."""
        script = f"({_PLACE})({json.dumps(label)})"
        place = self.evaluate(script)
        time.sleep(1.0)
        return place is not None and place == self.evaluate(script)

    def fill(self, label: str, *values: float, seconds: float = 90.0) -> None:
        """Type numbers into the fields beside this label, each ended with Tab, until they are there."""
        for index, value in enumerate(values):
            deadline = time.monotonic() + seconds
            while not self._type(label, index, value):
                assert time.monotonic() < deadline, f"no field labelled {label!r} takes {value:g}:\n{self.text()}"
                time.sleep(0.2)

    def _type(self, label: str, index: int, value: float) -> bool:
        where = f"({json.dumps(label)}, {index})"
        if not self.evaluate(f"({_SELECT}){where}"):
            return False
        self.call("Input.insertText", text=f"{value:g}")
        for kind in ("rawKeyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key="Tab", code="Tab", windowsVirtualKeyCode=9)
        time.sleep(0.2)
        typed = self.evaluate(f"({_VALUE}){where}")
        return bool(typed) and float(typed) == value

    def is_on(self, label: str) -> bool:
        """Whether the checkbox with this label is checked."""
        script = f"""
            (() => {{
                const named = [...document.querySelectorAll('label')].find(
                    each => each.innerText.trim() === {json.dumps(label)} && each.offsetParent !== null);
                let around = named;
                while (around && !around.querySelector('input')) around = around.parentElement;
                return around ? around.querySelector('input').checked : null;
            }})()
        """
        on = self.evaluate(script)
        assert on is not None, f"no checkbox is labelled {label!r}"
        return on

    def drag(self, x: float, y: float, right: float, down: float) -> None:
        """Press at a place in pixels, move the mouse by so many and let go."""
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        time.sleep(0.5)
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button="left", clickCount=1)
        for step in range(1, 9):
            at = {"x": x + right * step / 8, "y": y + down * step / 8}
            self.call("Input.dispatchMouseEvent", type="mouseMoved", button="left", buttons=1, **at)
            time.sleep(0.1)
        x, y = x + right, y + down
        self.call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, button="left", clickCount=1)

    def press(self, x: float, y: float) -> None:
        """Press and let go at a place in pixels."""
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def turn_wheel(self, x: float, y: float, pixels: float) -> None:
        """Towards oneself with the mouse at a place: away from what is there."""
        self.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=pixels)

    def reload(self) -> None:
        self.call("Page.reload")

    def screenshot(self, path: Path) -> bytes:
        """Without the notice that there is no GPU."""
        notices = "document.querySelectorAll('.mantine-Notifications-root')"
        self.evaluate(f"{notices}.forEach(each => each.style.display = 'none')")
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return data

    def close(self) -> None:
        """Close the tab: one left open goes on painting."""
        self._session = None
        self.call("Target.closeTarget", targetId=self._target)
        self.forget()

    def forget(self) -> None:
        """Hang up, also on a browser that is gone."""
        self._socket.close()
