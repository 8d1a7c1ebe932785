#!/usr/bin/env python3
"""The coordinator's page in a real browser: dashboard_browser.py PROGRAMS. Exit status 77 where there is no Chromium.

A coordinator and two workers as processes: a job whose name is markup, a job that fails, a worker that is killed, and at last a
coordinator that is gone."""

import os
import signal
import subprocess
import sys

from devtools import Browser, run, wait_for

NAME = "<img src=x onerror=alert(1)>"


class Farm:
    def __init__(self, programs, folder):
        self.programs, self.folder, self.processes = programs, folder, []
        data = os.path.join(folder, "data")
        self.coordinator = self.start("gleaner-coordinator", "--listen", "127.0.0.1:0", "--http", "127.0.0.1:0", "--data", data)
        self.address = self.coordinator.stdout.readline().strip()
        log = os.path.join(folder, "0.log")
        words = wait_for(lambda: "HTTP on " in open(log).read() and open(log).read(), "the coordinator")
        self.page = "http://" + words.split("HTTP on ")[1].split(",")[0] + "/"
        self.workers = [self.start("gleaner-worker", "--coordinator", self.address, "--threads", "1", "--name", name)
                        for name in ("lamp", "spot")]

    def start(self, program, *words):
        with open(os.path.join(self.folder, f"{len(self.processes)}.log"), "w", encoding="utf-8") as log:
            process = subprocess.Popen([os.path.join(self.programs, program), *words], stdout=subprocess.PIPE, stderr=log, text=True)
        self.processes.append(process)
        return process

    def gleaner(self, *words):
        environment = {**os.environ, "GLEANER_COORDINATOR": self.address}
        return subprocess.run([os.path.join(self.programs, "gleaner"), *words], env=environment, check=True, text=True,
                              stdout=subprocess.PIPE).stdout.strip()

    def end(self):
        for process in self.processes:
            process.send_signal(signal.SIGKILL)
            process.wait()


def rows(browser, table):
    return browser.value(f"[...document.querySelectorAll('#{table} tbody tr')].map((row) => row.innerText)")


def check_running(browser, farm, scene):
    """A job that runs: its row, its picture, and a name that is markup."""
    browser.open(farm.page)
    browser.until("document.body.className === 'live'", "an answer")
    assert "No jobs yet" in rows(browser, "jobs")[0], rows(browser, "jobs")
    browser.until("document.querySelectorAll('#workers .idle').length === 2", "two workers")
    farm.gleaner("submit", scene, "--size", "128x128", "--spp", "65536", "--name", NAME, "--quiet")
    browser.until("document.querySelector('#jobs .running')", "the job")
    assert NAME in rows(browser, "jobs")[0], rows(browser, "jobs")
    browser.until("document.querySelector('.picture img')?.naturalWidth === 128", "its picture", 120)
    assert NAME in browser.value("document.querySelector('.picture .title').textContent")
    assert browser.value("document.querySelectorAll('[onerror], img[src=x]').length") == 0
    first = browser.value("document.querySelector('#jobs progress').value")
    browser.until(f"document.querySelector('#jobs progress').value > {first}", "progress")


def check_shape(browser):
    """No width of a screen makes the page wider than it is, and tables keep their roles as cards."""
    for width, phone in ((1280, False), (980, False), (768, False), (390, True), (320, True)):
        browser.size(width, 844, phone)
        assert browser.value("document.scrollingElement.scrollWidth <= innerWidth"), width
    tree = browser.call("Accessibility.getFullAXTree")["nodes"]
    roles = [node["role"]["value"] for node in tree if not node.get("ignored")]
    assert roles.count("table") == 3 and "row" in roles and "cell" in roles, roles
    browser.size(1280, 900)


def check_trouble(browser, farm, scene):
    """A job that fails, a worker that is killed, and a coordinator that is."""
    farm.workers[1].send_signal(signal.SIGKILL)
    browser.until("document.querySelector('#workers .lost')", "the lost worker")
    assert any("spot" in row and "its connection ended" in row for row in rows(browser, "workers")), rows(browser, "workers")
    # A file where the folder of pictures is to be.
    jobs = os.path.join(farm.folder, "data", "jobs")
    assert not os.path.exists(jobs), jobs
    open(jobs, "w", encoding="utf-8").close()
    failing = farm.gleaner("submit", scene, "--size", "16x16", "--spp", "1", "--priority", "9", "--quiet")
    browser.until("document.querySelector('#jobs .failed')", "the failed job", 60)
    assert any(failing in row and "cannot make the folder" in row for row in rows(browser, "jobs")), rows(browser, "jobs")
    for url in browser.asked():
        assert url.startswith((farm.page, "blob:")), url
    assert browser.complaints() == [], browser.complaints()
    farm.coordinator.send_signal(signal.SIGKILL)
    browser.until("document.body.className === 'stale'", "the page to say so")
    words = browser.value("document.getElementById('trouble').innerText")
    assert "has not answered since" in words and "cannot be reached" in words, words


def test(folder):
    farm, browser = Farm(sys.argv[1], folder), Browser()
    try:
        scene = os.path.join(folder, "box.glb")
        farm.gleaner("scene", "cornell-box", "-o", scene)
        check_running(browser, farm, scene)
        check_shape(browser)
        check_trouble(browser, farm, scene)
    finally:
        browser.close()
        farm.end()
    print("the page shows what the farm does")


if __name__ == "__main__":
    sys.exit(run(test))
