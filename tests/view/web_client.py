"""The browser's side of trocar-view's WebSocket, for tests. See clients/view/stream/wire_format.h and web.h."""
import json
import socket
import struct
import subprocess

ACKNOWLEDGE, TAKE, STEER, RESET, RELEASE, _, HOLE, DROP, UNDO, LEAVE, REMOVE, PROBE = range(1, 13)
PICTURE, SAMPLES, STATUS, REPLY = 2, 3, 4, 6


def start(*command):
    """Starts a program and waits until it is ready. Returns it and the lines it printed before that."""
    program = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    said = []
    for line in program.stdout:
        if line == "ready\n":
            return program, said
        said.append(line)
    raise AssertionError(f"{command[0]} ended: {said}")


class Browser:
    """A browser. `status`, `picture` and `depth` are the latest received."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=30)
        self.socket.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
                            "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
                            "Sec-WebSocket-Protocol: trocar-view\r\n\r\n".encode())
        self.stream = self.socket.makefile("rb")
        assert b" 101 " in self.stream.readline()
        while self.stream.readline() != b"\r\n":
            pass
        self.status, self.picture, self.reply, self.depth = {}, None, None, {}

    def close(self):
        self.stream.close()
        self.socket.close()

    def say(self, action, *numbers, needle=0):
        content = struct.pack("<I6fI", action, *numbers, *[0.0] * (6 - len(numbers)), needle)
        self.socket.sendall(struct.pack("<BB4x", 0x82, 0x80 | len(content)) + content)  # masked with zeros

    def hear(self):
        """Waits for one update and acknowledges it."""
        _, length = struct.unpack(">BB", self.stream.read(2))
        if length >= 126:
            length, = struct.unpack(*((">H", self.stream.read(2)) if length == 126 else (">Q", self.stream.read(8))))
        frame = self.stream.read(length)
        self.say(ACKNOWLEDGE)
        while frame:
            kind, size = struct.unpack_from("<II", frame)
            self.take(kind, frame[8:8 + size])
            frame = frame[8 + (size + 7) // 8 * 8:]

    def take(self, kind, content):
        if kind == STATUS:
            self.status = json.loads(content)
        elif kind == REPLY:
            self.reply = json.loads(content)
        elif kind == PICTURE:
            self.picture = content
        elif kind == SAMPLES:
            for at in range(0, len(content) - 63, 64):
                self.depth[struct.unpack_from("<i", content, at + 60)[0]] = struct.unpack_from("<f", content, at + 32)[0]

    def until(self, true, steer=None):
        """Receives updates, steering all the while, until `true()` holds."""
        for _ in range(4000):
            if true():
                return
            if steer:
                self.say(STEER, *steer)
            self.hear()
        raise AssertionError(f"never; {self.status}, {self.reply}, depth {self.depth}")

    def needle(self, index):
        """Returns the needle's nodes (n, 3), in m, in the newest picture, or None if the needle is not in it."""
        at = 32 + (64 if struct.unpack_from("<I", self.picture, 28)[0] else 0)
        for _ in range(struct.unpack_from("<I", self.picture, 20)[0]):
            number, joints, contacts, points = struct.unpack_from("<4I", self.picture, at + 24)
            if number == index:
                line = struct.unpack_from(f"<{3 * joints}f", self.picture, at + 48)
                return [line[i:i + 3] for i in range(0, 3 * joints, 3)]
            at += 48 + 12 * joints + 36 * contacts + 24 * points
        return None

    def displacements(self):
        """Returns the displacements (m) in the newest picture, three values for each node in turn."""
        scale, = struct.unpack_from("<f", self.picture, 16)
        count, = struct.unpack_from("<I", self.picture, 24)
        return [scale * value for value in struct.unpack(f"<{3 * count}h", self.picture[-6 * count:])]
