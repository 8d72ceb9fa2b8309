#!/usr/bin/env python3
"""The web page: what it shows of a scene, what it does with people, whom it lets in, several browsers, and its end."""

import asyncio
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import unittest
from pathlib import Path

import cv2
import numpy as np
import rosgraph
import rospkg
import rospy
import rostest
from std_msgs.msg import String
from tornado.httpclient import HTTPClient, HTTPClientError, HTTPRequest
from tornado.ioloop import IOLoop
from tornado.websocket import websocket_connect

from hri_msgs.msg import IdsList
from hri_pipeline.testing import (
    Browser,
    Camera,
    HeardProcess,
    Latest,
    held_by,
    photograph,
    pid_of,
    wait_for,
)

WAIT_S = 30.0
CAMERA = "camera_color_optical_frame"
OVERLAY = "/visualization/overlay"
ACTION = {"Content-Type": "application/json", "X-Ros4hri": "1"}
NASTY = "<img src=x onerror=document.title='hacked'>"


class Page(HeardProcess):
    """The node, and what it has said."""

    def __init__(self, *parameters, name="hri_web"):
        self.text = ""
        super().__init__(subprocess.Popen(
            ["rosrun", "hri_person_manager", "web", "__name:=" + name, "_port:=0", *parameters],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True,
            env=dict(os.environ, PYTHONUNBUFFERED="1")), self.read)

    def read(self):
        for line in self.process.stdout:
            self.text += line

    def wait(self):
        said = wait_for(lambda: re.search(r"the page is at http://([^/]+):(\d+)/", self.text), WAIT_S,
                        lambda: "the address; said: " + self.text)
        self.port = int(said.group(2))
        self.url = "http://localhost:{}".format(self.port)
        return self


class Stream:
    """One browser at the stream; asks for nothing and answers pictures only if told to."""

    def __init__(self, page, answers=True, **headers):
        self.states, self.pictures, self._answers = [], [], answers
        self.loop = IOLoop(make_current=False)
        request = HTTPRequest(page.url.replace("http", "ws") + "/live", headers=headers)
        self.connection = self.loop.run_sync(lambda: websocket_connect(request), timeout=WAIT_S)

    def read(self, seconds, until=lambda self: False):
        """Read for so long, or until a condition holds; False when the connection has ended."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until(self):
            message = self.loop.run_sync(lambda: self.connection.read_message(), timeout=WAIT_S)
            if message is None:
                return False
            if isinstance(message, str):
                self.states.append(json.loads(message))
                continue
            self.pictures.append(message)
            if self._answers:
                self.loop.run_sync(lambda: self.connection.write_message("shown"))
        return True

    def close(self):
        self.connection.close()
        self.loop.run_sync(lambda: asyncio.sleep(0.05))
        self.loop.close(all_fds=True)


def is_full(stream):
    """Whether it has shown the picture, the robot, and three people with their places, of whom one looks at one."""
    if not stream.pictures or not stream.states:
        return False
    people = stream.states[-1]["people"]
    return (len(people) == 3 and all(person["place"] and person["place"]["ellipse"] for person in people)
            and any(person["looks_at"] is not None for person in people) and stream.states[-1]["robot"] is not None)


def ask(page, path="/", body=None, **headers):
    """(status, headers, text) of the answer."""
    client = HTTPClient()
    try:
        answer = client.fetch(HTTPRequest(page.url + path, method="GET" if body is None else "POST", body=body,
                                          headers=headers, follow_redirects=False, request_timeout=WAIT_S))
    except HTTPClientError as error:
        answer = error.response
    finally:
        client.close()
    return answer.code, answer.headers, answer.body.decode()


def act(page, headers=ACTION, **request):
    """(status, answer) of an action."""
    status, _, text = ask(page, "/people", json.dumps(request), **headers)
    return status, json.loads(text)


class WebTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.page = Page().wait()
        cls.camera = Camera(photograph(1, 640), image=OVERLAY, info="", rate=10.0, frame=CAMERA)
        cls.persons = Latest("/humans/persons/tracked", IdsList)
        wait_for(lambda: cls.persons.value and len(cls.persons.value.ids) == 3, WAIT_S, "the people of the scene")

    @classmethod
    def tearDownClass(cls):
        cls.camera.close()
        cls.page.kill()

    def started(self, *parameters, **options):
        page = Page(*parameters, **options)
        self.addCleanup(page.kill)
        return page

    def looking(self, node="/hri_web"):
        return any(node in nodes for topic, nodes in rosgraph.Master("/test").getSystemState()[1]
                   if topic == OVERLAY)

    def test_the_page_comes_with_all_it_needs_and_allows_nothing_else(self):
        folder = Path(rospkg.RosPack().get_path("hri_person_manager")) / "web"
        for path, name in (("/", "index.html"), ("/page.js", "page.js"), ("/page.css", "page.css")):
            status, headers, text = ask(self.page, path)
            self.assertEqual((status, text), (200, (folder / name).read_text(encoding="utf-8")))
            self.assertIn("default-src 'none'; script-src 'self'", headers["Content-Security-Policy"])
            self.assertEqual(headers["X-Frame-Options"], "DENY")
            self.assertEqual(set(re.findall(r"https?://[^\"' ]+", text)) - {"http://www.w3.org/2000/svg"}, set())
        self.assertEqual(ask(self.page, "/../package.xml")[0], 404)
        self.assertEqual(ask(self.page, "/people")[0], 405)

    def test_another_name_or_page_is_refused_everywhere(self):
        evil = {"Host": "evil.example:8080"}
        self.assertEqual(ask(self.page, **evil)[0], 403)
        self.assertEqual(act(self.page, dict(ACTION, **evil), command="list")[0], 403)
        for headers in (evil, {"Origin": "http://evil.example"}):
            with self.assertRaises(HTTPClientError):
                Stream(self.page, **headers)
        for headers in ({"Content-Type": "application/json"}, dict(ACTION, Origin="http://evil.example"),
                        {"X-Ros4hri": "1", "Content-Type": "text/plain"}):
            self.assertEqual(act(self.page, headers, command="forget", id="bob")[0], 403)

    def test_bad_requests_get_a_reason(self):
        for body, words in (("", "JSON"), ('{"command": "x"}', "command"),
                            ('{"command": "enrol", "id": "ada"}', "agree")):
            status, _, text = ask(self.page, "/people", body, **ACTION)
            self.assertEqual(status, 400)
            self.assertIn(words, json.loads(text)["message"])
        self.assertEqual(ask(self.page, "/people", "x" * 200000, **ACTION)[0], 400)
        status, answer = act(self.page, command="name", id="nobody", name="X")
        self.assertEqual((status, answer["success"]), (200, False))
        self.assertIn("nobody", answer["message"])
        stream = Stream(self.page)
        stream.loop.run_sync(lambda: stream.connection.write_message("x" * 5000))
        self.assertFalse(stream.read(5.0), "more than a browser ever says ends its stream")
        self.assertEqual(ask(self.page)[0], 200)

    def test_the_stream_shows_the_scene_and_the_picture(self):
        stream = Stream(self.page)
        self.addCleanup(stream.close)
        stream.read(WAIT_S, is_full)
        self.assertTrue(is_full(stream), stream.states[-1:])
        state = stream.states[-1]
        self.assertEqual((state["frame"], state["camera"]), ("map", ""))
        self.assertTrue(all(0.5 < person["place"]["x"] < 6.0 for person in state["people"]), state)
        picture = cv2.imdecode(np.frombuffer(stream.pictures[-1], np.uint8), cv2.IMREAD_COLOR)
        wanted = photograph(1, 640)
        self.assertEqual(picture.shape, wanted.shape)
        self.assertLess(np.abs(picture.astype(int) - wanted).mean(), 6.0)

    def test_names_are_given_and_everything_is_exported_and_forgotten(self):
        status, answer = act(self.page, command="name", id="ann", name="Ada Ø")
        self.assertEqual((status, answer["success"]), (200, True))
        name = Latest("/humans/persons/ann/name", String)
        self.addCleanup(name.close)
        wait_for(lambda: name.data == "Ada Ø", WAIT_S, "the name on its topic")
        stream = Stream(self.page)
        self.addCleanup(stream.close)
        stream.read(WAIT_S, lambda self: self.states and "Ada Ø" in [one["name"] for one in self.states[-1]["people"]])
        self.assertIn("Ada Ø", [person["name"] for person in stream.states[-1]["people"]])
        known = act(self.page, command="list")[1]["known"]
        self.assertEqual([(one["name"], one["here"]) for one in known if one["id"] == "ann"], [("Ada Ø", True)])
        data = act(self.page, command="export", id="ann")[1]["data"]
        self.assertEqual(data["persons"][0]["name"], "Ada Ø")
        status, answer = act(self.page, command="enrol", id="ann", consent=True)
        self.assertEqual((status, answer["success"]), (200, False))
        self.assertIn("recogniser", answer["message"])
        self.assertTrue(act(self.page, command="forget", id="ann")[1]["success"])
        wait_for(lambda: not any(one["name"] for one in act(self.page, command="list")[1]["known"]
                                 if one["id"] == "ann"), WAIT_S, "her name is forgotten")

    def test_the_privacy_notice_is_that_of_the_nodes(self):
        status, answer = act(self.page, command="privacy")
        self.assertEqual(status, 200)
        self.assertIn("/hri_interactions computes: who looks at whom, groups", answer["message"])

    def test_a_browser_that_does_not_read_holds_up_nobody(self):
        self.camera.show(np.random.default_rng(1).integers(0, 255, (480, 640, 3), np.uint8))
        self.addCleanup(lambda: self.camera.show(photograph(1, 640)))
        deaf, slow = socket.create_connection(("localhost", self.page.port)), Stream(self.page, answers=False)
        self.addCleanup(deaf.close)
        self.addCleanup(slow.close)
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.sendall("GET /live HTTP/1.1\r\nHost: localhost:{}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                     "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
                     .format(self.page.port).encode())
        quick = Stream(self.page)
        self.addCleanup(quick.close)
        quick.read(2.0)
        before = len(quick.pictures)
        quick.read(3.0)
        self.assertGreater(len(quick.pictures) - before, 15, "pictures in 3 s of a camera with 10 Hz")
        slow.read(1.0)
        self.assertEqual(len(slow.pictures), 1, "one picture, and no other before it is shown")

    def test_nobody_who_looks_costs_nothing(self):
        wait_for(lambda: not self.looking(), WAIT_S, "nobody looks")
        stream = Stream(self.page)
        stream.read(WAIT_S, lambda self: self.pictures)
        self.assertTrue(self.looking())
        stream.loop.run_sync(lambda: stream.connection.write_message("pause"))
        wait_for(lambda: not self.looking(), WAIT_S, "the picture is not wanted while the window is hidden")
        stream.loop.run_sync(lambda: stream.connection.write_message("resume"))
        wait_for(self.looking, WAIT_S, "it is wanted again")
        stream.close()
        wait_for(lambda: not self.looking(), WAIT_S, "nobody looks any more")

    def test_browsers_that_come_and_go_leave_nothing(self):
        page = self.started(name="hri_web_many").wait()

        def visit():
            streams = [Stream(page) for _ in range(5)]
            for stream in streams:
                self.assertTrue(stream.read(WAIT_S, lambda self: self.states and self.states[-1]["people"]))
                self.assertEqual(ask(page)[0], 200)
            for stream in streams:
                stream.close()

        def rested():
            wait_for(lambda: not self.looking("/hri_web_many"), WAIT_S, "nobody looks any more")
            return held_by(pid_of("/hri_web_many"))

        visit()
        before = rested()
        for _ in range(4):
            visit()

        def as_before():
            now = rested()
            return now.descriptors <= before.descriptors + 2 and now.threads <= before.threads + 1

        wait_for(as_before, WAIT_S, lambda: "{} after {}".format(rested(), before), period=0.5)

    def test_too_many_browsers_are_refused(self):
        page = self.started("_max_browsers:=2", name="hri_web_two").wait()
        streams = [Stream(page) for _ in range(3)]
        for stream in streams:
            self.addCleanup(stream.close)
        self.assertEqual([stream.read(1.0) for stream in streams], [True, True, False])
        self.assertIn("too many", streams[2].connection.close_reason)

    def test_on_a_network_the_token_is_needed_everywhere(self):
        page = self.started("_address:=0.0.0.0", name="hri_web_net").wait()
        said = wait_for(lambda: re.findall(r"\?token=(\S+)", page.text), WAIT_S, "the token")
        self.assertEqual(len(said), 1)
        token = said[0]
        for path, headers in (("/", {}), ("/page.js", {}), ("/nothing", {}), ("/?token=x" + token, {}),
                              ("/", {"Cookie": "ros4hri_{}=x{}".format(page.port, token)})):
            status, _, text = ask(page, path, **headers)
            self.assertEqual(status, 403, path)
            self.assertIn("token", json.loads(text)["message"])
        self.assertEqual(act(page, command="list")[0], 403)
        with self.assertRaises(HTTPClientError):
            Stream(page)
        status, headers, _ = ask(page, "/?token=" + token)
        self.assertEqual((status, headers["Location"]), (302, "/"))
        self.assertIn("HttpOnly", headers["Set-Cookie"])
        self.assertIn("SameSite=Strict", headers["Set-Cookie"])
        cookie = {"Cookie": headers["Set-Cookie"].split(";")[0]}
        self.assertEqual(ask(page, **cookie)[0], 200)
        self.assertEqual(act(page, dict(ACTION, **cookie), command="list")[0], 200)
        stream = Stream(page, **cookie)
        self.addCleanup(stream.close)
        self.assertTrue(stream.read(WAIT_S, lambda self: self.states))
        logs = [Path(rospkg.get_log_dir()) / name for name in os.listdir(rospkg.get_log_dir()) if "hri_web_net" in name]
        self.assertTrue(logs)
        self.assertNotIn(token, "".join(path.read_text(errors="replace") for path in logs))

    def test_a_port_that_is_taken_and_wrong_settings_are_told_in_one_line(self):
        for parameters, words in ((["_port:={}".format(self.page.port)], "cannot be used"),
                                  (["_address:=robot"], "no IP address"), (["_token_file:=/nothing"], "token_file")):
            page = self.started(*parameters, name="hri_web_wrong")
            self.assertEqual(page.code(), 1)
            self.assertIn(words, page.text)
            self.assertNotIn("Traceback", page.text)

    def test_a_page_for_looking_only(self):
        page = self.started("_actions:=false", name="hri_web_look").wait()
        self.assertEqual(act(page, command="list")[0], 200)
        status, answer = act(page, command="forget", id="bob")
        self.assertEqual(status, 403)
        self.assertIn("looking only", answer["message"])

    def test_it_ends_at_once_with_browsers_at_it(self):
        page = self.started("_person_manager:=/nobody", name="hri_web_end").wait()
        stream = Stream(page)
        stream.read(WAIT_S, lambda self: self.states)
        asks = socket.create_connection(("localhost", page.port))
        self.addCleanup(asks.close)
        asks.sendall("POST /people HTTP/1.1\r\nHost: localhost\r\nX-Ros4hri: 1\r\nContent-Type: application/json\r\n"
                     "Content-Length: 19\r\n\r\n{\"command\": \"list\"}".encode())
        stream.read(0.5)
        page.process.send_signal(signal.SIGINT)
        began = time.monotonic()
        self.assertEqual(page.code(), 0, page.text)
        self.assertLess(time.monotonic() - began, 6.0)
        self.assertFalse(stream.read(WAIT_S))
        self.assertNotIn("Traceback", page.text)
        with self.assertRaises(OSError):
            socket.create_connection(("localhost", page.port))

    def browser(self):
        try:
            browser = Browser()
        except FileNotFoundError as error:
            self.skipTest(str(error))
        self.addCleanup(browser.close)

        def text():
            return browser.value("document.body?.innerText") or ""

        def sees(words):
            wait_for(lambda: words in text(), WAIT_S, lambda: "{!r} in {!r}".format(words, text()), period=0.1)
        return browser, sees

    @staticmethod
    def keep(browser, name):
        """Leave a picture of the page beside the results of the test."""
        if os.environ.get("ROS_TEST_RESULTS_DIR"):
            browser.picture(os.path.join(os.environ["ROS_TEST_RESULTS_DIR"], name), whole=True)

    def test_in_a_browser_people_are_seen_and_renamed_and_names_are_never_markup(self):
        page = self.started(name="hri_web_seen").wait()
        browser, sees = self.browser()
        browser.open(page.url)

        def count(what):
            return browser.value("document.querySelectorAll({!r}).length".format(what))

        wait_for(lambda: browser.value("document.getElementById('picture')?.naturalWidth") == 640, WAIT_S,
                 "the picture", period=0.1)
        sees("connected")
        sees("bob (no name)")
        browser.value("[...document.querySelectorAll('#people li')].find(li => li.title === 'bob')"
                      ".querySelector('[data-command=name]').click()")
        sees("Rename bob")
        browser.value("document.getElementById('ask-name').value = {}; document.getElementById('ask-ok').click()"
                      .format(json.dumps(NASTY)))
        sees(NASTY)
        self.assertEqual((browser.value("document.title"), count("li img")), ("People here", 0))
        wait_for(lambda: count("#map .ellipse") == 3 and count("#map .gaze"), WAIT_S, "people on the map", period=0.1)
        self.assertEqual(browser.value(
            "[...document.querySelectorAll('button, input, img, svg#map')].filter(one => !(one.textContent.trim() || "
            "one.alt || one.getAttribute('aria-label') || one.labels?.length)).map(one => one.outerHTML)"), [])
        self.keep(browser, "web.png")
        browser.command("Emulation.setDeviceMetricsOverride", width=360, height=740, deviceScaleFactor=2, mobile=True)
        self.assertLessEqual(browser.value("document.documentElement.scrollWidth"), 360)
        self.keep(browser, "web_phone.png")
        page.kill()
        sees("the robot does not answer")

    def test_in_a_browser_what_is_missing_is_told(self):
        page = self.started("visualization/overlay:=/no/overlay", name="hri_web_missing").wait()
        browser, sees = self.browser()
        browser.open(page.url)
        sees("there is no camera: no node works on images, and nothing is on /no/overlay")
        wait_for(lambda: browser.value("document.querySelectorAll('[data-command=enrol]:enabled').length"), WAIT_S,
                 "somebody to enrol", period=0.1)
        for face, body, fact in ((True, True, ""), (False, True, "face not seen"), (False, False, "not seen")):
            person = {"id": "eve", "anonymous": True, "since": 1.0, "looks_at": None, "face": face, "body": body}
            browser.value("showPeople([{}])".format(json.dumps(person)))
            button, facts = ("document.querySelector('[title=eve] {}')".format(what) for what in
                             ("[data-command=enrol]", ".words"))
            self.assertEqual(browser.value("{}.disabled".format(button)), not face)
            self.assertEqual(browser.value("{}.title".format(button)), "" if face else "the face has to be seen now")
            self.assertEqual(browser.value("{}.textContent".format(facts)).split(" · ")[1:], [fact] if fact else [])
        wait_for(lambda: browser.value("document.querySelectorAll('[data-command=enrol]:enabled').length"), WAIT_S,
                 "somebody to enrol", period=0.1)
        browser.value("document.querySelector('[data-command=enrol]:enabled').click(); "
                      "document.getElementById('ask-ok').click()")
        sees("the person has to agree to be recognised")
        browser.value("document.getElementById('ask-cancel').click(); document.getElementById('privacy').click()")
        sees("/hri_interactions computes: who looks at whom")


if __name__ == "__main__":
    rospy.init_node("web_test")
    rostest.rosrun("hri_person_manager", "web", WebTest, sys.argv)
