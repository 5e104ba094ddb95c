#!/usr/bin/env python3
"""Drives `crumple explore` in a real browser: `explore.py CRUMPLE [--screenshots DIR]`.

Needs chromium and its driver on the path; without them prints a message and ends with 77. Needs only the standard
library, because the driver's protocol is JSON over HTTP (https://www.w3.org/TR/webdriver2/).
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
    """Session of the browser's driver."""

    def __init__(self, driver, browser):
        self.process = subprocess.Popen(
            [driver, "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        for line in self.process.stdout:
            if found := re.search(r"started successfully on port (\d+)", line):
                self.root = f"http://127.0.0.1:{found[1]}"
                break
        else:
            raise SystemExit("the driver ended before it listened")
        options = {
            "binary": browser,
            "args": ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"],
        }
        body = {"capabilities": {"alwaysMatch": {"goog:chromeOptions": options}}}
        self.session = ""
        self.session = "/session/" + self.ask("POST", "/session", body)["sessionId"]

    def ask(self, method, path, body=None):
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self.root + self.session + path, data, {"Content-Type": "application/json"}, method=method
        )
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
        """Drags the pointer from the first place over the others, in shares of the element's width and height."""
        self.script("document.querySelector(arguments[0]).scrollIntoView({block: 'center'})", selector)
        box = self.script(
            "const b = document.querySelector(arguments[0]).getBoundingClientRect();"
            "return [b.left, b.top, b.width, b.height]",
            selector,
        )
        moves = [
            {
                "type": "pointerMove",
                "duration": 15,
                "x": round(box[0] + x * box[2]),
                "y": round(box[1] + y * box[3]),
                "origin": "viewport",
            }
            for x, y in places
        ]
        actions = [moves[0], {"type": "pointerDown", "button": 0}, *moves[1:], {"type": "pointerUp", "button": 0}]
        self.ask(
            "POST",
            "/actions",
            {
                "actions": [
                    {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": actions}
                ]
            },
        )

    def wait(self, what, text, *arguments):
        """Waits until a script returns a true value, and returns it."""
        until = time.monotonic() + 60
        while not (found := self.script(text, *arguments)):
            error = self.script(
                "const e = document.getElementById('error'); return e && !e.hidden ? e.textContent : ''"
            )
            assert time.monotonic() < until, f"{what} did not appear within a minute; error on the page: {error!r}"
            time.sleep(0.05)
        return found

    def set_view(self, width, height, dark):
        """Sets the size and the colour scheme."""
        self.devtools(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.devtools("Emulation.setEmulatedMedia", {"features": [scheme]})

    def devtools(self, command, parameters):
        return self.ask("POST", "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def picture(self, path):
        picture = self.devtools("Page.captureScreenshot", {"format": "png", "captureBeyondViewport": False})
        path.write_bytes(base64.b64decode(picture["data"]))

    def end(self):
        try:
            self.ask("DELETE", "")
        finally:
            self.process.terminate()
            self.process.wait()


def first_verdict(browser):
    """Waits for a verdict and returns it."""
    return browser.wait(
        "a verdict", "const v = document.querySelector('.verdict'); return v && {...v.dataset, words: v.textContent}"
    )


def final_verdict(browser):
    """Waits until the page is idle and returns its verdict."""
    first_verdict(browser)
    browser.wait("the idle page", "return !document.querySelector('[aria-busy]')")
    return first_verdict(browser)


def main(crumple, screenshots):
    """Runs all checks; returns the exit code."""
    tools = {
        name: shutil.which(name) or shutil.which(other)
        for name, other in [("chromium", "chromium-browser"), ("chromedriver", "chromium.chromedriver")]
    }
    if missing := [name for name, path in tools.items() if path is None]:
        print(f"skipped: there is no {' and no '.join(missing)} on the path")
        return SKIPPED
    with tempfile.TemporaryDirectory() as folder:
        return drive(pathlib.Path(folder), crumple, tools, screenshots)


def drive(folder, crumple, tools, screenshots):
    """Runs all checks in a folder."""

    def run(*arguments):
        return subprocess.run([crumple, *arguments], cwd=folder, check=True, capture_output=True, text=True).stdout

    search = ["falsify", "--controller", "match-leader", "--space", "high-risk"]
    run(*search, "--budget", "300", "--out", "found")
    braking_events = pathlib.Path(__file__).parent.parent / "braking_events.py"
    events = subprocess.run([sys.executable, braking_events, "6"], check=True, capture_output=True).stdout
    (folder / "events.csv").write_bytes(events)
    arguments = [
        "explore",
        "paper-1",
        "found",
        "--recording",
        "events.csv",
        "--suite",
        "euro-ncap-2023",
        "--controller",
        "baseline",
        "--format",
        "json",
        "--quiet",
    ]
    server = subprocess.Popen([crumple, *arguments], cwd=folder, stdout=subprocess.PIPE, text=True)
    address = json.loads(server.stdout.readline())["address"]
    browser = Browser(tools["chromedriver"], tools["chromium"])
    try:
        browser.set_view(1400, 1000, False)
        measure(browser, address)
        draw(browser)
        find_and_download(browser, address, folder, run)
        replay(browser, address)
        open_margin(browser, address)
        if screenshots:
            show(browser, address, pathlib.Path(screenshots))
    finally:
        browser.end()
        server.send_signal(2)
        ended = server.wait(timeout=20)
    assert ended == 0, f"the server ends with {ended} at Ctrl-C"
    return 0


def measure(browser, address):
    """Checks that dragging a slider changes the verdict at once."""
    browser.open(address)
    before = final_verdict(browser)
    assert before["verdict"] == "collision", before
    browser.script("performance.clearMeasures('drag')")
    browser.drag("#slide-speed-2", [(0.5, 0.5)] + [(0.5 - step * 0.26 / 60, 0.5) for step in range(61)])
    after = final_verdict(browser)
    assert after["verdict"] == "safe", after
    times = sorted(browser.script("return performance.getEntriesByName('drag').map((entry) => entry.duration)"))
    median, percentile = times[len(times) // 2], times[int(0.95 * len(times))]
    print(f"dragging: {len(times)} responses, median {median:.1f} ms, 95 % {percentile:.1f} ms, max {times[-1]:.1f} ms")
    status = browser.wait("text for a screen reader", "return document.getElementById('said').textContent")
    assert "No collision" in status, status
    # The keyboard changes the verdict, too.
    browser.keys("#slide-speed-2", "\ue010")
    assert final_verdict(browser)["verdict"] == "collision"
    browser.click("#reset")
    assert final_verdict(browser)["collision"] == before["collision"]
    browser.click("#avoid")
    answer = browser.wait("an answer", "return document.getElementById('avoided').dataset.verdict")
    assert answer == "avoidable", answer


def draw(browser):
    """Checks drawing of the leader's braking by pointer and keys; without braking there is no collision."""
    browser.drag("#pad", [(0.01, 0.3), (0.5, 0.3), (0.99, 0.3)])
    drawn = final_verdict(browser)
    assert drawn["verdict"] == "safe", drawn
    browser.drag("#pad", [(0.2, 0.9), (0.99, 0.9)])
    drawn = final_verdict(browser)
    assert drawn["verdict"] == "collision", drawn
    browser.keys("#pad", "\ue014\ue015\ue015")
    value = browser.script("return document.getElementById('pad').getAttribute('aria-valuetext')")
    assert re.fullmatch(r"at [\d.]+ s: -?[\d.]+ m/s²", value), value
    browser.click("#lead-back")
    final_verdict(browser)


def find_and_download(browser, address, folder, run):
    """Checks that a campaign's failure, edited and downloaded, gives the same collision on the command line."""
    browser.open(address + "campaigns")
    browser.wait("failures", "return document.querySelector('#distinct a')")
    cells = browser.script("return document.querySelectorAll('#maps a .cell').length")
    assert cells > 10, cells
    browser.click("#distinct a")
    browser.wait("its scenario", "return location.search === '?campaign=0&counterexample=0'")
    shown = final_verdict(browser)
    assert shown["verdict"] == "collision" and shown["words"].startswith("match-leader"), shown
    browser.drag("#slide-speed-1", [(0.5, 0.5), (0.55, 0.5)])
    shown = final_verdict(browser)
    browser.script("document.getElementById('name').value = '../dragged: \"a failure\"'")
    browser.script(
        "URL.createObjectURL = (blob) => { blob.text().then((text) => { window.downloaded = text; }); return '#'; };"
    )
    browser.click("#download")
    text = browser.wait("the text of the file", "return window.downloaded")
    status = browser.wait("a command", "return document.getElementById('saved').textContent")
    assert "crumple simulate dragged-a-failure.toml --controller match-leader" in status, status
    file = folder / "dragged-a-failure.toml"
    file.write_text(text)
    repeated = json.loads(run("simulate", str(file), "--controller", "match-leader", "--format", "json"))
    collision = repeated["outcome"].get("time_s")
    expected = None if shown.get("collision") is None else float(shown["collision"])
    assert collision == expected, (repeated["outcome"], shown)
    print(f"downloaded and repeated: collision at {collision} s in both")


def compare_on_a_drive(browser):
    """Adds a controller that brakes on the fifth recorded drive, and opens this drive."""
    browser.click("#chosen input[value='idm']")
    browser.wait("counts of both controllers", "return document.querySelectorAll('.commanded div').length === 12")
    browser.click("[data-drive='4']")
    browser.wait("the fifth drive", "return document.getElementById('drive-name').textContent === 'Drive 5'")


def replay(browser, address):
    """Checks that recorded drives show what a controller would command, and that a braking can be seen closely."""
    browser.open(address + "recordings")
    browser.wait("all counts", "return document.querySelectorAll('.commanded div').length === 6")
    compare_on_a_drive(browser)
    browser.click("#brakings [data-from]")
    browser.wait("the whole drive to return to", "return !document.getElementById('whole').hidden")
    legend = browser.script("return document.getElementById('figures').textContent")
    assert "commanded by baseline" in legend and "commanded by idm" in legend, legend


def open_margin(browser, address):
    """Checks that the end of a margin of a suite opens the simulation that fails."""
    browser.open(address + "suites")
    link = browser.wait(
        "a margin",
        "const a = document.querySelector(\"#tests a[href*='fails_at=']\"); return a && a.getAttribute('href')",
    )
    browser.click(f"#tests a[href='{link}']")
    browser.wait("its scenario", "return location.search.startsWith('?suite=0')")
    shown = final_verdict(browser)
    about = browser.script("return document.getElementById('about').textContent")
    assert "does not pass" in about and "no certification" in about, about
    assert shown["verdict"] == "collision", (link, shown)


def show(browser, address, folder):
    """Saves images of each view, narrow and wide, light and dark."""
    folder.mkdir(parents=True, exist_ok=True)
    views = {"scenario": "", "campaigns": "campaigns", "recordings": "recordings", "suites": "suites"}
    ready = {
        "campaigns": "return document.querySelectorAll('#maps a .cell').length > 5",
        "recordings": "return document.querySelectorAll('.commanded div').length === 6",
        "suites": "return document.querySelector('#tests a')",
    }
    for name, path in views.items():
        for width in (400, 1400):
            for dark in (False, True):
                browser.set_view(width, 1000, dark)
                browser.open(address + path)
                if path:
                    browser.wait(path, ready[name])
                    if name == "recordings":
                        compare_on_a_drive(browser)
                else:
                    final_verdict(browser)
                height = browser.script("return document.documentElement.scrollHeight")
                overflow = browser.script(
                    "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
                )
                assert overflow <= 0, f"{name} at {width} pixels is {overflow} pixels too wide"
                browser.set_view(width, min(height, 6000), dark)
                time.sleep(0.2)
                browser.picture(folder / f"{name}-{width}-{'dark' if dark else 'light'}.png")


if __name__ == "__main__":
    options = sys.argv[2:]
    sys.exit(main(str(pathlib.Path(sys.argv[1]).resolve()), options[1] if options[:1] == ["--screenshots"] else None))
