#!/usr/bin/python3
"""Tests needles that change hands in trocar-view with a live server. A browser that disconnects leaves its needle in the tissue unchanged, and another browser
takes it unchanged. A needle that moves to a hole enters no other hole.

usage: test_view_hands.py BUILD_DIR SOURCE_DIR
"""
import os
import signal
import sys
import tempfile
import unittest
from pathlib import Path

import web_client as web
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../shared"))
from in_namespace import in_namespace

BUILD, SOURCE = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
in_namespace(SOURCE)
SCENE = SOURCE / "meshes/implant.yaml"
LENGTH, FACE = 0.2, -0.025                                     # m, length of the scene's needle, and z of the template's face
place = lambda column, row: (5e-3 * (6 - column), 5e-3 * (row - 6))    # m, x and y of a hole; column A is on the patient's right


class Hands(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        Path(folder.name, "index.html").touch()
        self.page = folder.name
        self.server = self.start_server()
        self.addCleanup(self.server.wait)
        self.addCleanup(self.server.kill)
        self.open_view()
        self.addCleanup(lambda: (self.view.kill(), self.view.wait()))

    def start_server(self):
        """Starts the server, with real-time priority if permitted, because a gap between poses at the skin may make a needle buckle."""
        try:
            return web.start(BUILD / "server/trocar-server", "--scene", SCENE)[0]
        except AssertionError:
            return web.start(BUILD / "server/trocar-server", "--scene", SCENE, "--allow-non-rt")[0]

    def open_view(self):
        self.view, said = web.start(BUILD / "clients/view/trocar-view", "--scene", SCENE, "--port", "0", "--page", self.page)
        self.port = int(said[0].rstrip("/\n").rsplit(":", 1)[1])

    def browse(self):
        browser = web.Browser(self.port)
        browser.until(lambda: browser.status.get("alive"))
        return browser

    def take(self, browser, needle=0):
        self.ask(browser, lambda: browser.say(web.TAKE, needle=needle), lambda: browser.status["drives"] and self.state(browser, needle) == ("held", "here"))

    def ask(self, browser, request, done):
        """Repeats a request for which the viewer may not be ready yet."""
        for _ in range(30):
            if done():
                return
            request()
            for _ in range(8):
                browser.hear()
        browser.until(done)

    def state(self, browser, needle):
        needles = browser.status.get("needles")    # absent while the server is silent
        if not needles:
            return None, None
        described = needles[needle]
        return described.get("state"), described.get("owned")

    def go_to(self, browser, column, row):
        self.ask(browser, lambda: browser.say(web.HOLE, 0, column, row), lambda: (browser.status.get("hole") or {}).get("column") == column)

    def insert(self, browser, depth, needle=0):
        """Inserts a needle through hole E4 to a depth of `depth` (m) in the tissue, and waits a little."""
        self.take(browser, needle)
        self.go_to(browser, 4, 6)
        browser.until(lambda: browser.depth.get(needle, 0) > depth, (0, 0, 0.5))
        browser.say(web.STEER)
        self.rest(browser)

    def rest(self, browser):
        for _ in range(60):
            browser.say(web.STEER)
            browser.hear()

    def seen(self, browser, needle=0):
        """Returns the tip's position and the tissue's displacement, in mm."""
        browser.picture = None
        browser.until(lambda: browser.picture is not None and browser.needle(needle) is not None)
        return [1e3 * x for x in browser.needle(needle)[-1]], [1e3 * x for x in browser.displacements()]

    def settled(self, browser, needle=0):
        """Like `seen`, but after the needle has come to rest, because the tissue pushes it back slightly when nobody holds it."""
        before, now = None, self.seen(browser, needle)
        for _ in range(60):
            if before and max(abs(a - b) for a, b in zip(before[0], now[0])) < 0.02:
                return now
            for _ in range(30):
                browser.hear()
            before, now = now, self.seen(browser, needle)
        self.fail(f"the needle does not come to rest: {before[0]}, {now[0]}")

    def check_same(self, before, after, tolerance):
        """Checks that the tip's position and the tissue's displacement (mm) have not changed."""
        for a, b in zip(before[0], after[0]):
            self.assertAlmostEqual(a, b, delta=tolerance)
        self.assertGreater(max(map(abs, before[1])), 1)
        self.assertLess(max(abs(a - b) for a, b in zip(before[1], after[1])), tolerance)

    def test_a_browser_that_goes_away_leaves_the_needle_as_it_is(self):
        browser = self.browse()
        self.insert(browser, 0.06)
        before = self.seen(browser)
        browser.close()    # as if the page had been closed or the connection lost
        browser = self.browse()
        browser.until(lambda: self.state(browser, 0) == ("resting", "nobody"))
        rested = self.settled(browser)
        self.take(browser)
        self.rest(browser)
        self.check_same(rested, self.seen(browser), 0.2)
        self.check_same(before, rested, 3.0)
        self.assertEqual(browser.status["lost"], "")
        browser.say(web.RELEASE)                # as the "Let go" button does
        browser.until(lambda: self.state(browser, 0) == ("resting", "nobody") and not browser.status["drives"])
        self.take(browser)
        self.view.send_signal(signal.SIGTERM)   # the viewer ends
        self.assertEqual(self.view.wait(30), 0)
        self.open_view()
        browser = self.browse()
        browser.until(lambda: self.state(browser, 0) == ("resting", "nobody"))
        self.ask(browser, lambda: browser.say(web.REMOVE, needle=0), lambda: self.state(browser, 0)[0] == "held")
        self.take(browser)                      # the needle is outside the tissue, so it need not be released first
        browser.until(lambda: browser.depth.get(0) == 0)

    def test_a_needle_that_nobody_holds_is_taken_as_it_is(self):
        """The viewer is killed, so it cannot tell the server, which takes the needle away from it after two seconds."""
        browser = self.browse()
        self.insert(browser, 0.06)
        self.view.kill()
        self.view.wait()
        browser.close()
        self.open_view()
        browser = self.browse()
        browser.until(lambda: self.state(browser, 0) == ("held", "nobody"))
        before = self.seen(browser)
        self.take(browser)
        self.rest(browser)
        self.check_same(before, self.seen(browser), 3.0)
        browser.close()

    def test_a_needle_on_its_way_to_a_hole_enters_no_other_one(self):
        """The forward key is held down from the start."""
        browser = self.browse()
        forward = lambda: browser.say(web.STEER, 0, 0, 1)
        self.ask(browser, lambda: (browser.say(web.TAKE, needle=0), forward()), lambda: browser.status["drives"])
        self.ask(browser, lambda: (browser.say(web.HOLE, 0, 7, 6), forward()), lambda: (browser.status.get("hole") or {}).get("column") == 7)
        way = []

        def note():
            line = browser.needle(0) if browser.picture else None
            if line:
                way.append((line[0], line[-1]))
            return browser.depth.get(0, 0) > 0.02
        browser.until(note, (0, 0, 1))
        x, y = place(7, 6)
        inside = [base for base, tip in way if tip[2] > FACE + 0.011]    # deeper than the needle can have been before the order to go to the hole
        self.assertTrue(inside)
        for base in inside:
            self.assertAlmostEqual(base[0], x, delta=6e-4)
            self.assertAlmostEqual(base[1], y, delta=6e-4)
        browser.close()

    def test_the_reason_for_letting_go_is_what_is_known(self):
        browser = self.browse()
        self.take(browser)
        self.server.kill()
        browser.until(lambda: not browser.status["drives"])
        self.assertEqual(browser.status["lost"], "nothing was heard from the server for half a second")
        browser.close()


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
