#!/usr/bin/env python3
"""A session's page in a real browser: viewer_browser.py PROGRAMS. Exit status 77 where there is no Chromium.

A light is dragged, deepened and moved by keys; an object is dragged; the camera is turned, shifted and brought nearer; a light's strength and a material's
colour are changed. What the session holds is asked for beside the page, and what is drawn is read from its canvas."""

import json
import math
import os
import signal
import subprocess
import sys
import urllib.request

from devtools import Browser, run, wait_for

SIZE = 96  # pixels of the picture


class Session:
    def __init__(self, programs, folder):
        gleaner = os.path.join(programs, "gleaner")
        scene = os.path.join(folder, "lamps.glb")
        subprocess.run([gleaner, "scene", "punctual-lights", "-o", scene], check=True, stdout=subprocess.DEVNULL)
        environment = {name: value for name, value in os.environ.items() if name != "GLEANER_COORDINATOR"}
        self.process = subprocess.Popen([gleaner, "session", "--web", scene, "--size", f"{SIZE}x{SIZE}", "--refine", "0", "--quiet",
                                         "--look-at", "0,3,9,0,1,0,60",
                                         "--movable", "red sphere"], stdout=subprocess.PIPE, text=True, env=environment)
        self.url = self.process.stdout.readline().strip()

    def scene(self):
        with urllib.request.urlopen(self.url + "scene.json") as answer:
            return json.load(answer)

    def until(self, so, what):
        return wait_for(lambda: so(self.scene()), what)


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def place_of(camera, point):
    """Where the renderer's camera sees a point, in parts of the picture (scene/model/records.h); and how deep."""
    offset = [x - o for x, o in zip(point, camera["origin"])]
    depth = dot(offset, camera["forward"])
    return (0.5 + dot(offset, camera["right"]) / (2 * depth * camera["half_width"]),
            0.5 - dot(offset, camera["up"]) / (2 * depth * camera["half_height"]), depth)


def box(browser):
    return browser.value("(({left, top, width, height}) => [left, top, width, height])(document.getElementById('stage').getBoundingClientRect())")


def centre(browser, selector):
    return browser.value(f"(({{left, top, width, height}}) => [left + width / 2, top + height / 2])(document.querySelector('{selector}').getBoundingClientRect())")


def near(a, b, slack):
    return all(abs(x - y) <= slack for x, y in zip(a, b))


def settle(browser):
    """Until the page has sent all, and a picture shows it."""
    browser.until("!sending && since === null && unseen.length === 0", "a picture of all changes", 60)


def pixels(browser):
    return browser.value("[...document.getElementById('picture').getContext('2d').getImageData(0, 0, %d, %d).data]" % (SIZE, SIZE))


def change_between(before, after):
    return sum(abs(x - y) for x, y in zip(before, after)) / len(before)


def drag(browser, start, end, button="left", buttons=1, **more):
    browser.mouse("mouseMoved", *start)
    browser.mouse("mousePressed", *start, button, buttons, **more)
    for step in range(1, 9):
        browser.mouse("mouseMoved", *(s + (e - s) * step / 8 for s, e in zip(start, end)), button, buttons, **more)
    browser.mouse("mouseReleased", *end, button, 0, **more)


def check_drag(browser, session, part, marker, step, least_change):
    """A marker stands where the renderer's camera sees what it is of, the first of `part`; dragging it by `step` (parts of the picture)
    keeps the depth. Returns where the marker and the thing are then."""
    left, top, width, height = box(browser)
    before = session.scene()
    camera = before["camera"]
    x, y, depth = place_of(camera, before[part][0]["position"])
    start = centre(browser, marker)
    assert near(start, (left + x * width, top + y * height), 1.5), (start, x, y)
    picture = pixels(browser)
    goal = (start[0] + step[0] * width, start[1] + step[1] * height)
    drag(browser, start, goal)
    settle(browser)
    moved = session.scene()[part][0]["position"]
    after_x, after_y, after_depth = place_of(camera, moved)
    assert near((after_x, after_y), (x + step[0], y + step[1]), 0.01), (after_x, after_y, x, y)
    assert abs(after_depth - depth) < 1e-3 * depth, (after_depth, depth)
    assert near(centre(browser, marker), goal, 1.5)
    assert change_between(picture, pixels(browser)) > least_change, "the picture has not changed"
    return goal, moved


def check_light(browser, session):
    """A light is dragged; the wheel keeps its place of the picture, keys move it too."""
    before = session.scene()
    camera = before["camera"]
    goal, moved = check_drag(browser, session, "lights", "#light-0", (0.2, 0.1), 3)
    after_x, after_y, depth = place_of(camera, moved)
    browser.mouse("mouseWheel", *goal, deltaX=0, deltaY=-200)
    deeper = session.until(lambda scene: scene["lights"][0]["position"] != moved and scene["lights"][0]["position"], "the wheel")
    wheel_x, wheel_y, wheel_depth = place_of(camera, deeper)
    assert near((wheel_x, wheel_y), (after_x, after_y), 1e-3) and wheel_depth > 1.1 * depth, (wheel_depth, depth)
    for key in ("ArrowRight", "PageDown"):
        browser.call("Input.dispatchKeyEvent", type="keyDown", key=key)
        browser.call("Input.dispatchKeyEvent", type="keyUp", key=key)
    session.until(lambda scene: place_of(camera, scene["lights"][0]["position"])[2] < 0.99 * wheel_depth, "the keys")
    assert session.scene()["camera"] == camera and session.scene()["lights"][1] == before["lights"][1]


def check_object(browser, session):
    """An object that may move is dragged as a light is: in the plane of the picture, at its depth."""
    before = session.scene()
    check_drag(browser, session, "objects", "#object-0", (-0.15, -0.05), 1)
    after = session.scene()
    assert after["lights"] == before["lights"] and after["camera"] == before["camera"]


def check_camera(browser, session):
    """Turning keeps the distance from what it turns about, shifting the direction; coming nearer keeps both."""
    left, top, width, height = box(browser)
    bare = (left + 0.1 * width, top + 0.9 * height)
    assert browser.value(f"document.elementFromPoint({bare[0]}, {bare[1]}).id") == "picture"
    before = session.scene()["camera"]
    about = browser.value("pivot()")
    drag(browser, bare, (bare[0] + 0.1 * width, bare[1] - 0.1 * height))
    settle(browser)
    turned = session.scene()["camera"]
    assert math.isclose(math.dist(turned["origin"], about), math.dist(before["origin"], about), rel_tol=1e-4)
    assert 0.5 < dot(turned["forward"], before["forward"]) < 0.98, turned
    assert abs(turned["right"][1]) < 1e-5, "the horizon leans"
    drag(browser, bare, (bare[0] + 0.1 * width, bare[1]), "right", 2)
    settle(browser)
    shifted = session.scene()["camera"]
    assert near(shifted["forward"], turned["forward"], 1e-5) and math.dist(shifted["origin"], turned["origin"]) > 0.1, shifted
    browser.mouse("mouseWheel", *bare, deltaX=0, deltaY=-300)
    settle(browser)
    nearer = session.scene()["camera"]
    assert near(nearer["forward"], turned["forward"], 1e-5)
    assert dot([n - s for n, s in zip(nearer["origin"], shifted["origin"])], nearer["forward"]) > 0.1
    browser.value("document.getElementById('back').click()")
    settle(browser)
    assert near(session.scene()["camera"]["origin"], before["origin"], 1e-5)


def check_panel(browser, session):
    """Strength and colours, which are linear in the scene and sRGB to people."""
    def put(name, value):
        browser.value(f"(() => {{ const node = document.getElementById('{name}'); node.value = '{value}';"
                      " node.dispatchEvent(new Event(node.localName === 'select' ? 'change' : 'input', {bubbles: true})); })()")
        settle(browser)
    before = session.scene()
    put("light", "1")
    put("light-strength", "1")
    assert near(session.scene()["lights"][1]["intensity"], [2 * x for x in before["lights"][1]["intensity"]], 1e-4)
    put("light-strength", "-10")
    assert session.scene()["lights"][1]["intensity"] == [0, 0, 0]
    put("light-strength", "0")
    assert near(session.scene()["lights"][1]["intensity"], before["lights"][1]["intensity"], 1e-4)
    picture = pixels(browser)
    put("material-color", "#ff8000")
    assert near(session.scene()["materials"][0]["base_color"], (1, 0.2158605, 0), 1e-4), session.scene()["materials"][0]
    assert change_between(picture, pixels(browser)) > 1, "the picture has not changed"


def check_end(browser, session):
    """Closing a page changes nothing; Ctrl-C ends the session, and a page that is open says so."""
    assert browser.complaints() == [], browser.complaints()
    for url in browser.asked():
        assert url.startswith(session.url), url
    browser.open("about:blank")
    assert session.process.poll() is None
    browser.open(session.url)
    browser.until("document.getElementById('waiting').hidden", "the picture again")
    assert browser.value("document.getElementById('material-color').value") == "#ff8000", "the page forgot a change"
    session.process.send_signal(signal.SIGINT)
    assert session.process.wait(30) == 0, session.process.returncode
    browser.until("document.body.className === 'stale'", "the page to say so")


def test(folder):
    session, browser = Session(sys.argv[1], folder), Browser()
    try:
        browser.open(session.url)
        browser.until("document.getElementById('waiting').hidden", "the first picture", 120)
        check_light(browser, session)
        check_object(browser, session)
        check_camera(browser, session)
        check_panel(browser, session)
        for width, phone in ((1280, False), (768, False), (390, True), (320, True)):
            browser.size(width, 844, phone)
            assert browser.value("document.scrollingElement.scrollWidth <= innerWidth"), width
        check_end(browser, session)
    finally:
        browser.close()
        session.process.kill()
        session.process.wait()
    print("the page shows and changes the session's scene")


if __name__ == "__main__":
    sys.exit(run(test))
