#!/usr/bin/python3
"""Tests that if trocar-view is stopped while a browser drives, the needle is released and the program exits cleanly.

usage: test_view_stop.py BUILD_DIR SOURCE_DIR
Recorded wrenches, played back with LCM, replace a server.
"""
import base64
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile

BUILD, SOURCE = sys.argv[1:3]
ACKNOWLEDGE, TAKE, STATUS = 1, 2, 4


def write_log(path):
    """Writes a log of the figure-8 wrenches, 10 per second, for a needle that nobody owns. The wrenches are computed by a replay, because a live view refuses
    the older message types in the recording."""
    subprocess.run([f"{BUILD}/clients/trocar-replay", "--scene", f"{SOURCE}/meshes/figure8.yaml", "--poses", f"{SOURCE}/tests/traces/figure8.log",
                    "--out", f"{path}.replayed", "--every", "10", "--quiet"], check=True)
    log, at, time = open(f"{path}.replayed", "rb").read(), 0, 1
    with open(path, "wb") as out:
        while at < len(log):
            name, data = struct.unpack_from(">II", log, at + 20)
            event = bytearray(log[at:at + 28 + name + data])
            at += len(event)
            if event[28:28 + name] != b"TROCAR_WRENCH":
                continue
            struct.pack_into(">Q", event, 12, time)
            struct.pack_into(">Q", event, 28 + name + 24, 0)  # clears the session, which follows fingerprint, utime and tick
            out.write(event)
            time += 100000


def connect(port):
    """Opens a WebSocket to trocar-view. Returns the socket, and the stream after the handshake."""
    view = socket.create_connection(("127.0.0.1", port), timeout=30)
    view.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
                 "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
                 "Sec-WebSocket-Protocol: trocar-view\r\n\r\n".encode())
    stream = view.makefile("rb")
    assert b" 101 " in stream.readline()
    while stream.readline() != b"\r\n":
        pass
    return view, stream


def say(view, action):
    view.sendall(struct.pack("<BB4xI28x", 0x82, 0x80 | 32, action))  # masked with zeros


def frames(stream):
    while True:
        _, length = struct.unpack(">BB", stream.read(2))
        if length >= 126:
            length, = struct.unpack(*((">H", stream.read(2)) if length == 126 else (">Q", stream.read(8))))
        yield stream.read(length)


def statuses(frame):
    while frame:
        kind, length = struct.unpack_from("<II", frame)
        if kind == STATUS:
            yield json.loads(frame[8:8 + length])
        frame = frame[8 + (length + 7) // 8 * 8:]


def drive(port):
    """Requests the needle repeatedly until the browser has it."""
    view, stream = connect(port)
    for frame in frames(stream):
        say(view, ACKNOWLEDGE)
        for status in statuses(frame):
            if status["drives"]:
                return view, stream
            say(view, TAKE)


def main():
    with tempfile.TemporaryDirectory() as page:
        write_log(f"{page}/wrenches.log")
        open(os.path.join(page, "index.html"), "w").close()
        view = subprocess.Popen([f"{BUILD}/clients/view/trocar-view", "--scene", f"{SOURCE}/meshes/figure8.yaml", "--port", "0", "--page", page,
                                 "--lcm-url", f"file://{page}/wrenches.log"],
                                stdout=subprocess.PIPE, text=True)
        try:
            port = int(view.stdout.readline().rstrip("/\n").rsplit(":", 1)[1])
            assert view.stdout.readline() == "ready\n"
            browser = drive(port)
            view.send_signal(signal.SIGTERM)
            status = view.wait(30)
            assert status == 0, f"exit status {status} when stopped while a browser drives"
            browser[0].close()
        finally:
            view.kill()
    print("passed")


main()
