#!/usr/bin/env python3
"""Drives `crumple explore` in a real browser: `explore.py CRUMPLE [--screenshots DIR]`.

Needs chromium and its driver on the path; without them it says so and ends with 77. Nothing but the standard library: the driver
speaks HTTP and JSON (https://www.w3.org/TR/webdriver2/).
"""

import base64
import json
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request

SKIPPED = 77
ELEMENT = "element-6066-11e4-a52e-4f735466cecf"


class Browser:
    """A session with the driver."""

    def __init__(self, driver, browser):
        self.process = subprocess.Popen([driver, "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        for line in self.process.stdout:
            if found := re.search(r"started successfully on port (\d+)", line):
                self.root = f"http://127.0.0.1:{found[1]}"
                break
        else:
            raise SystemExit("the driver ended before it began")
        options = {"binary": browser, "args": ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]}
        asked = {"capabilities": {"alwaysMatch": {"goog:chromeOptions": options}}}
        self.session = ""
        self.session = "/session/" + self.ask("POST", "/session", asked)["sessionId"]

    def ask(self, method, path, body=None):
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.root + self.session + path, data, {"Content-Type": "application/json"}, method=method)
        try:
            return json.load(urllib.request.urlopen(request, timeout=120))["value"]
        except urllib.error.HTTPError as error:
            raise AssertionError(f"{method} {path}: {error.read().decode()[:600]}") from error

    def open(self, address):
        self.ask("POST", "/url", {"url": address})

    def script(self, text, *arguments):
        return self.ask("POST", "/execute/sync", {"script": text, "args": list(arguments)})

    def find(self, selector):
        return self.ask("POST", "/element", {"using": "css selector", "value": selector})[ELEMENT]

    def click(self, selector):
        self.script("document.querySelector(arguments[0]).scrollIntoView({block: 'center'})", selector)
        self.ask("POST", f"/element/{self.find(selector)}/click", {})

    def keys(self, selector, text):
        self.ask("POST", f"/element/{self.find(selector)}/value", {"text": text})

    def drag(self, selector, places):
        """Presses the pointer at the first place, and moves it over the others; shares of the element's width and height."""
        self.script("document.querySelector(arguments[0]).scrollIntoView({block: 'center'})", selector)
        box = self.script("const b = document.querySelector(arguments[0]).getBoundingClientRect(); return [b.left, b.top, b.width, b.height]", selector)
        moves = [
            {"type": "pointerMove", "duration": 15, "x": round(box[0] + x * box[2]), "y": round(box[1] + y * box[3]), "origin": "viewport"}
            for x, y in places
        ]
        actions = [moves[0], {"type": "pointerDown", "button": 0}, *moves[1:], {"type": "pointerUp", "button": 0}]
        self.ask("POST", "/actions", {"actions": [{"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": actions}]})

    def wait(self, what, text, *arguments):
        """Waits until a script says something true, and gives that back."""
        until = time.monotonic() + 60
        while not (found := self.script(text, *arguments)):
            error = self.script("const e = document.getElementById('error'); return e && !e.hidden ? e.textContent : ''")
            assert time.monotonic() < until, f"{what} did not come within a minute; the page says: {error!r}"
            time.sleep(0.05)
        return found

    def look(self, width, height, dark):
        self.cdp("Emulation.setDeviceMetricsOverride", {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False})
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.cdp("Emulation.setEmulatedMedia", {"features": [scheme]})

    def cdp(self, command, parameters):
        return self.ask("POST", "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def picture(self, path):
        picture = self.cdp("Page.captureScreenshot", {"format": "png", "captureBeyondViewport": False})
        path.write_bytes(base64.b64decode(picture["data"]))

    def end(self):
        try:
            self.ask("DELETE", "")
        finally:
            self.process.terminate()
            self.process.wait()


def first_verdict(browser):
    return browser.wait("a verdict", "const v = document.querySelector('.verdict'); return v && {...v.dataset, words: v.textContent}")


def settled(browser):
    """The verdict once nothing is under way any more."""
    first_verdict(browser)
    browser.wait("rest", "return !document.querySelector('[aria-busy]')")
    return first_verdict(browser)


def main(crumple, screenshots):
    tools = {name: shutil.which(name) or shutil.which(other) for name, other in [("chromium", "chromium-browser"), ("chromedriver", "chromium.chromedriver")]}
    if missing := [name for name, path in tools.items() if path is None]:
        print(f"skipped: there is no {' and no '.join(missing)} on the path")
        return SKIPPED
    with tempfile.TemporaryDirectory() as folder:
        return drive(pathlib.Path(folder), crumple, tools, screenshots)


def drive(folder, crumple, tools, screenshots):
    def run(*arguments):
        return subprocess.run([crumple, *arguments], cwd=folder, check=True, capture_output=True, text=True).stdout

    search = ["falsify", "--controller", "match-leader", "--space", "high-risk"]
    run(*search, "--budget", "300", "--out", "found")
    (folder / "saved").mkdir()
    running = subprocess.Popen([crumple, "--quiet", *search, "--method", "cma-es", "--budget", "3000000", "--out", "running"], cwd=folder, stdout=subprocess.DEVNULL)
    while not (folder / "running" / "evaluations.journal").exists():
        time.sleep(0.05)
    # Let the campaign find something; `watch` stops it before the page is measured.
    time.sleep(1)
    arguments = ["explore", "paper-1", "found", "running", "--controller", "baseline", "--out", "saved", "--format", "json", "--quiet"]
    server = subprocess.Popen([crumple, *arguments], cwd=folder, stdout=subprocess.PIPE, text=True)
    address = json.loads(server.stdout.readline())["address"]
    browser = Browser(tools["chromedriver"], tools["chromium"])
    try:
        browser.look(1400, 1000, False)
        watch(browser, address, running)
        measure(browser, address)
        draw(browser)
        find_and_save(browser, address, folder, run)
        if screenshots:
            show(browser, address, pathlib.Path(screenshots))
    finally:
        browser.end()
        running.kill()
        running.wait()
        server.send_signal(2)
        ended = server.wait(timeout=20)
    assert ended == 0, f"Ctrl-C ends it with {ended}"
    return 0


def watch(browser, address, running):
    """A campaign while it runs: its evaluations grow."""
    browser.open(address + "campaigns")
    browser.script("document.getElementById('campaign').value = '1'; document.getElementById('campaign').dispatchEvent(new Event('change', {bubbles: true}))")
    count = "const m = /running, (\\d+) of/.exec(document.getElementById('words').textContent); return m ? Number(m[1]) : 0"
    first = browser.wait("a running campaign", count)
    later = browser.wait("more evaluations", count.replace("return m ? Number(m[1]) : 0", "return m && Number(m[1]) > arguments[0] ? Number(m[1]) : 0"), first)
    browser.wait("a map", "return document.querySelectorAll('#maps a .cell').length > 5")
    running.send_signal(19)
    print(f"a running campaign: {first}, then {later} evaluations seen")


def measure(browser, address):
    """Dragging a slider changes the verdict, at once."""
    browser.open(address)
    before = settled(browser)
    assert before["verdict"] == "collision", before
    browser.script("performance.clearMeasures('drag')")
    browser.drag("#slide-speed-2", [(0.5, 0.5)] + [(0.5 - step * 0.26 / 60, 0.5) for step in range(61)])
    after = settled(browser)
    assert after["verdict"] == "safe", after
    times = sorted(browser.script("return performance.getEntriesByName('drag').map((entry) => entry.duration)"))
    print(f"dragging: {len(times)} answers, median {times[len(times) // 2]:.1f} ms, 95 % {times[int(0.95 * len(times))]:.1f} ms, longest {times[-1]:.1f} ms")
    said = browser.wait("words for a screen reader", "return document.getElementById('said').textContent")
    assert "No collision" in said, said
    # With the keyboard too.
    browser.keys("#slide-speed-2", "\ue010")
    assert settled(browser)["verdict"] == "collision"
    browser.click("#reset")
    assert settled(browser)["contact"] == before["contact"]
    browser.click("#avoid")
    answer = browser.wait("an answer", "return document.getElementById('avoided').dataset.verdict")
    assert answer == "avoidable", answer


def draw(browser):
    """The leader's braking by hand, and by keys: none at all is no reason for a contact."""
    browser.drag("#pad", [(0.01, 0.3), (0.5, 0.3), (0.99, 0.3)])
    drawn = settled(browser)
    assert drawn["verdict"] == "safe", drawn
    browser.drag("#pad", [(0.2, 0.9), (0.99, 0.9)])
    drawn = settled(browser)
    assert drawn["verdict"] == "collision", drawn
    browser.keys("#pad", "\ue014\ue015\ue015")
    value = browser.script("return document.getElementById('pad').getAttribute('aria-valuetext')")
    assert re.fullmatch(r"at [\d.]+ s: -?[\d.]+ m/s²", value), value
    browser.click("#lead-back")
    settled(browser)


def find_and_save(browser, address, folder, run):
    """From a campaign's failure to a file that the command line runs to the same contact."""
    browser.open(address + "campaigns")
    browser.wait("failures", "return document.querySelector('#distinct a')")
    cells = browser.script("return document.querySelectorAll('#maps a .cell').length")
    assert cells > 10, cells
    browser.click("#distinct a")
    browser.wait("its scenario", "return location.search === '?campaign=0&counterexample=0'")
    seen = settled(browser)
    assert seen["verdict"] == "collision" and seen["words"].startswith("match-leader"), seen
    browser.drag("#slide-speed-1", [(0.5, 0.5), (0.55, 0.5)])
    seen = settled(browser)
    browser.script("document.getElementById('name').value = '../dragged: \"a failure\"'")
    browser.click("#save")
    said = browser.wait("where it was saved", "return document.getElementById('saved').textContent")
    files = list((folder / "saved").iterdir())
    assert len(files) == 1 and files[0].name == "dragged-a-failure.toml", (files, said)
    again = json.loads(run("simulate", str(files[0]), "--controller", "match-leader", "--format", "json"))
    contact = again["outcome"].get("time_s")
    assert (contact is None) == (seen.get("contact") is None) and (contact is None or contact == float(seen["contact"])), (again["outcome"], seen)
    print(f"saved and run again: contact at {contact} s in both")


def show(browser, address, folder):
    """What each view looks like, narrow and wide, light and dark."""
    folder.mkdir(parents=True, exist_ok=True)
    views = {"scenario": "", "campaigns": "campaigns"}
    for name, path in views.items():
        for width in (400, 1400):
            for dark in (False, True):
                browser.look(width, 1000, dark)
                browser.open(address + path)
                if path:
                    browser.wait("a map", "return document.querySelectorAll('#maps a .cell').length > 5")
                else:
                    settled(browser)
                height = browser.script("return document.documentElement.scrollHeight")
                overflow = browser.script("return document.documentElement.scrollWidth - document.documentElement.clientWidth")
                assert overflow <= 0, f"{name} at {width} pixels is {overflow} pixels too wide"
                browser.look(width, min(height, 6000), dark)
                time.sleep(0.2)
                browser.picture(folder / f"{name}-{width}-{'dark' if dark else 'light'}.png")


if __name__ == "__main__":
    options = sys.argv[2:]
    sys.exit(main(str(pathlib.Path(sys.argv[1]).resolve()), options[1] if options[:1] == ["--screenshots"] else None))
