#!/usr/bin/python3
"""A stand-in for the Haply Inverse Service, written only from the maker's documentation (clients/bridges/haply/message.h lists the pages).

usage: standin.py [PORT]     serves a device that moves 50 mm forward and back again every 4 s, until it is stopped; PORT: by default 10001
"""
import base64
import hashlib
import json
import math
import os
import socket
import sys
import threading
import time

MAGIC = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455, 1.3


def xyz(v):
    return dict(zip("xyz", v))


def frame(payload, opcode=1):
    length = len(payload)
    size = bytes([length]) if length < 126 else b"\x7e" + length.to_bytes(2, "big") if length < 1 << 16 else b"\x7f" + length.to_bytes(8, "big")
    return bytes([0x80 | opcode]) + size + payload


class Service:
    """One device, with a handle unless `handle` is None. Runs in a thread of its own while a test changes its attributes.

    position   m, right, forward, up: a function of the time (time.monotonic) or a constant
    frozen     True: a constant position is reported with the same digits every time
    forces     [(time, (x, y, z), key)] of every set_cursor_force that has been received, N
    answer     function of the state (a dictionary) that returns the text to send, returns None to send nothing, or raises Disconnect
    """

    def __init__(self, port=0, version="3.5", realtime=False):
        self.version, self.position, self.orientation, self.handle = version, (0.0, 0.1, 0.1), (1.0, 0.0, 0.0, 0.0), "wireless_verse_grip"
        self.buttons, self.calibrated, self.answer, self.device = {"a": False, "b": False, "c": False}, True, json.dumps, "049D"
        self.forces, self.first, self.states, self.inquiries = [], [], [], 0
        self.frozen, self.counted = False, 0  # frozen: whether to send the same state again and again
        self.port, self.realtime = port, realtime
        self.start()

    def start(self):
        self.listener, self.client = socket.create_server(("127.0.0.1", self.port)), None
        self.port = self.listener.getsockname()[1]
        self.thread = threading.Thread(target=self.serve, daemon=True)
        self.thread.start()

    def stop(self):
        self.listener.shutdown(socket.SHUT_RDWR) # wakes the thread
        self.listener.close()
        self.disconnect()
        self.thread.join()

    def disconnect(self):
        client = self.client
        if client:
            try:
                client.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def serve(self):
        if self.realtime:
            use_realtime()
        while True:
            try:
                self.client = self.listener.accept()[0]
            except OSError:
                return
            with self.client:
                self.client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                try:
                    self.talk(self.client.makefile("rb"))
                except (OSError, EOFError, Disconnect):
                    pass

    def talk(self, stream):
        key = b""
        while (line := stream.readline()) != b"\r\n":
            if not line:
                return
            if line.lower().startswith(b"sec-websocket-key:"):
                key = line.split(b":", 1)[1].strip()
        accept = base64.b64encode(hashlib.sha1(key + MAGIC).digest())
        self.client.sendall(b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: " + accept + b"\r\n\r\n")
        self.send(full=True)
        fresh = True
        while True:
            message = self.receive(stream)
            self.take(json.loads(message), fresh)
            fresh = False
            self.send()

    def receive(self, stream):
        def read(count):
            data = stream.read(count)
            if len(data) < count:
                raise EOFError
            return data
        head = read(2)
        if head[0] & 0xf == 8:
            raise EOFError
        assert head[0] == 0x81 and head[1] & 0x80, "a client's messages are whole and masked"
        length = head[1] & 0x7f
        if length == 126:
            length = int.from_bytes(read(2), "big")
        mask, data = read(4), read(length)
        repeated = (mask * (length // 4 + 1))[:length]
        return (int.from_bytes(data, "big") ^ int.from_bytes(repeated, "big")).to_bytes(length, "big")

    def take(self, message, fresh):
        if fresh:
            self.first.append(message)
        devices = message.get("inverse3", [])
        if not devices:
            self.inquiries += 1
        for device in devices:
            assert device["device_id"] == self.device, device
            (key, value), = device["commands"]["set_cursor_force"].items()
            self.forces.append((time.monotonic(), (value["x"], value["y"], value["z"]), key))

    def state(self, full):
        position = self.position(time.monotonic()) if callable(self.position) else self.position
        if not self.frozen:  # a real sensor's last digit changes with every reading
            self.counted += 1
            position = (position[0], position[1], position[2] + 1e-8 * (self.counted % 7))
        new = self.version >= "3.5"
        inverse3 = {"device_id": self.device,
                    "state": {"angular_position": {"a0": 0.0, "a1": 0.0, "a2": 0.0}, "angular_velocity": {"a0": 0.0, "a1": 0.0, "a2": 0.0},
                              "body_orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}, "cursor_position": xyz(position),
                              "cursor_velocity": xyz((0.0, 0.0, 0.0)), "control_mode" if new else "mode": "force" if self.forces else "idle"},
                    "status": {"calibrated": self.calibrated, "in_use": False, "power_supply": True, "ready": True, "started": True}}
        if full:
            inverse3["config"] = {"type": "inverse3", "device_info": {"major_version": 7, "minor_version": 1, "id": self.device},
                                  "gravity_compensation": {"enabled": True, "scaling_factor": 1}, "handedness": "right", "torque_scaling": {"enabled": True}}
        message = {"inverse3": [inverse3], "verse_grip": [], "wireless_verse_grip": []}
        if new:
            message["session_id"] = 7
        if self.handle:
            w, *rest = self.orientation
            state = {"orientation": {"w": w, **xyz(rest)}, "hall": 0}
            state.update({"button": self.buttons["a"]} if self.handle == "verse_grip" else {"buttons": self.buttons, "battery_level": 0.9})
            message[self.handle] = [{"device_id": "61548", "state": state, "status": {"error": 0, "ready": True}}]
        return message

    def send(self, full=False):
        text = self.answer(self.state(full))
        if text is not None:
            self.states.append(time.monotonic())
            self.client.sendall(frame(text if isinstance(text, bytes) else text.encode()))


def use_realtime():
    """Gives this thread real-time priority, if permitted, so that a busy machine does not look like a fault."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(20))
    except PermissionError:
        pass


class Disconnect(Exception):
    """Raised by `answer`: closes the connection."""


def main():
    if len(sys.argv) > 2 or sys.argv[1:] == ["--help"]:
        sys.exit(print(__doc__) if sys.argv[1:] == ["--help"] else __doc__)
    service = Service(int(sys.argv[1]) if len(sys.argv) > 1 else 10001)
    service.position = lambda now: (0.0, 0.1 + 0.025 * (1 - math.cos(math.pi * now / 2)), 0.1)
    print("ready", flush=True)
    while True:
        time.sleep(1)
        recent = [math.hypot(*force) for at, force, _ in service.forces if at > time.monotonic() - 1]
        print(f"{len(recent)} messages/s, at most {max(recent, default=0):.3f} N", flush=True)
        service.forces.clear()
        service.states.clear()


if __name__ == "__main__":
    main()
