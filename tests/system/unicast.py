"""The unicast protocol of docs/connect-a-device.md, for a test client, a test server and an attacker. Shares no code with the clients or the server."""
import hashlib
import hmac
import os
import socket
import struct
import time

HELLO, COOKIE, CONNECT, WELCOME, REFUSED, TO_SERVER, TO_CLIENT = range(1, 8)
WRONG_SECRET, FULL = 1, 2


def tag(key, data):
    return hmac.new(key, data, hashlib.sha256).digest()


def sealed(key, data):
    return data + tag(key, data)


def secret_key(path):
    with open(path, "rb") as file:
        return tag(b"trocar unicast 1", file.read().rstrip(b"\r\n"))


def handshake(key, kind, nonce, token=bytes(24)):
    return sealed(key, b"TU1" + bytes([kind]) + nonce + token)


def message(key, counter, channel, data, kind=TO_SERVER):
    return sealed(key, b"TU1" + bytes([kind]) + struct.pack(">Q", counter) + channel + b"\0" + data)


class Refused(Exception):
    pass


class Connection:
    """A connected client. `link` is a UDP socket connected to the server."""

    def __init__(self, link, path):
        self.link, self.key, self.nonce, self.counter = link, secret_key(path), os.urandom(16), 0
        link.settimeout(2)
        link.send(handshake(self.key, HELLO, self.nonce))
        link.send(handshake(self.key, CONNECT, self.nonce, self.expect(COOKIE)))
        token = self.expect(WELCOME)
        self.to_server, self.to_client = (tag(self.key, way + self.nonce + token) for way in (b"to server", b"to client"))

    def expect(self, kind):
        """Returns the token of the next datagram, which must be of this kind."""
        got = self.link.recv(2048)
        if got[3] == REFUSED:
            raise Refused(got[20])
        assert got[:4] == b"TU1" + bytes([kind]) and got[4:20] == self.nonce and len(got) == 76 and tag(self.key, got[:-32]) == got[-32:]
        return got[20:44]

    def send(self, channel, data):
        self.counter += 1
        self.link.send(message(self.to_server, self.counter, channel, data))

    def receive(self, longest):
        """Returns the messages that arrive within this time (s), as (channel, data)."""
        found, end = [], time.monotonic() + longest
        while time.monotonic() < end:
            self.link.settimeout(max(0.001, end - time.monotonic()))
            try:
                got = self.link.recv(2048)
            except socket.timeout:
                break
            assert got[:4] == b"TU1" + bytes([TO_CLIENT]) and tag(self.to_client, got[:-32]) == got[-32:]
            channel, _, data = got[12:-32].partition(b"\0")
            found.append((channel, data))
        return found


class Host:
    """The server's end of a connection. `link` is a UDP socket bound to the server's port."""

    def __init__(self, link, path):
        self.link, self.key, self.client, self.counter = link, secret_key(path), None, 0
        link.setblocking(False)

    def take(self):
        """Answers handshakes. Returns the messages that have arrived, as (channel, data)."""
        found = []
        while True:
            try:
                got, sender = self.link.recvfrom(2048)
            except BlockingIOError:
                return found
            kind, nonce = got[3], got[4:20]
            token = tag(self.key, nonce)[:24]   # any value will do, if it is the same for a repeated datagram
            if kind == HELLO:
                self.link.sendto(handshake(self.key, COOKIE, nonce, token), sender)
            elif kind == CONNECT:
                self.link.sendto(handshake(self.key, WELCOME, nonce, token), sender)
                self.to_server, self.to_client = (tag(self.key, way + nonce + token) for way in (b"to server", b"to client"))
                self.client = sender
            else:
                assert kind == TO_SERVER and tag(self.to_server, got[:-32]) == got[-32:]
                channel, _, data = got[12:-32].partition(b"\0")
                found.append((channel, data))

    def seal(self, channel, data):
        """Returns the client's next datagram."""
        self.counter += 1
        return message(self.to_client, self.counter, channel, data, TO_CLIENT)

    def put(self, datagram):
        self.link.sendto(datagram, self.client)
