#!/usr/bin/python3
"""Tests trocar-dds between a server and dds_peer, which plays the part of a ROS node: the topics' names and types; the bytes of the messages, decoded here from
the ROS message definitions; poses and wrenches, compared with those on LCM; refused poses; a second publisher; the release of the needle; and an insertion
through the virtual coupling, which is the default.

usage: test_dds.py BUILD_DIR SOURCE_DIR     Exit status 77: network namespaces are not available.
"""
import math
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

sys.dont_write_bytecode = True
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "shared"))
from in_namespace import in_namespace
from lcm_packets import lcm_socket, message_of, wait

BUILD, SOURCE = sys.argv[1:3]
BRIDGE = f"{BUILD}/clients/bridges/dds/trocar-dds"
START = (0.005, 0.003, -0.201)      # m, tip 1 mm in front of the skin
DOMAIN = "7"


class Network:
    """The poses, wrenches, commands and the newest status on LCM."""

    def __init__(self):
        self.socket = lcm_socket()
        self.poses, self.wrenches, self.commands, self.stiffness = [], [], [], None
        threading.Thread(target=self.read, daemon=True).start()

    def read(self):
        while True:
            channel, data = message_of(self.socket.recv(65536))
            if channel == b"TROCAR_POSE":
                self.poses.append(struct.unpack_from(">7d", data, 24))
            elif channel == b"TROCAR_WRENCH":
                self.wrenches.append(struct.unpack_from(">6d", data, 40) + struct.unpack_from(">d", data, 136))
            elif channel == b"TROCAR_COMMAND":
                self.commands.append(struct.unpack_from(">i", data, 16)[0])
            elif channel == b"TROCAR_STATUS":
                self.stiffness = struct.unpack_from(">d", data, 116)[0]    # N/m, of the virtual coupling


class Reader:
    """Reads a serialised sample (CDR, little-endian: each number is aligned to its own size, counted from the end of the four-byte header)."""

    def __init__(self, text):
        data = bytes.fromhex(text)
        assert data[:2] == b"\0\1", data[:4]
        self.data, self.at = data[4:], 0

    def take(self, kind):
        size = struct.calcsize(kind)
        self.at += -self.at % size
        value, = struct.unpack_from("<" + kind, self.data, self.at)
        self.at += size
        return value

    def text(self):
        size = self.take("I")
        value = self.data[self.at:self.at + size]
        self.at += size
        assert value[-1:] == b"\0"
        return value[:-1].decode()

    def header(self):
        stamp = self.take("i") + 1e-9 * self.take("I")
        return stamp, self.text()

    def numbers(self, count):
        return tuple(self.take("d") for _ in range(count))

    def sequence(self, read):
        return [read() for _ in range(self.take("I"))]

    def end(self):
        assert len(self.data) - self.at < 4, (self.at, len(self.data))     # padding


class Peer:
    def __init__(self, reliability="best-effort", domain=DOMAIN):
        self.process = subprocess.Popen([f"{BUILD}/tests/dds/dds_peer", domain, "arm/needle", reliability], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.samples = {"pose": [], "wrench": [], "joint_states": [], "endpoint": []}
        threading.Thread(target=self.read, daemon=True).start()

    def read(self):
        for line in self.process.stdout:
            kind, value = line.rstrip("\n").split(" ", 1)
            if kind == "endpoint":
                self.samples[kind].append(value)
                continue
            reader = Reader(value)
            sample = reader.header()
            if kind == "joint_states":
                sample += (reader.sequence(reader.text), *(reader.sequence(lambda: reader.take("d")) for _ in range(3)))
            else:
                sample += (reader.numbers(7 if kind == "pose" else 6),)
            reader.end()
            self.samples[kind].append(sample)

    def publish(self, position, orientation=(0, 0, 0, 1), frame="world"):
        self.process.stdin.write(" ".join(f"{value!r}" for value in (*position, *orientation)) + f" {frame}\n")
        self.process.stdin.flush()

    def end(self):
        self.process.stdin.close()
        assert self.process.wait(20) == 0, "dds_peer fails"


class Bridge:
    def __init__(self, *arguments):
        environment = dict(os.environ, ROS_DOMAIN_ID=DOMAIN)
        self.process = subprocess.Popen([BRIDGE, "--namespace=/arm/needle", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
        self.said = []
        threading.Thread(target=lambda: self.said.extend(self.process.stderr), daemon=True).start()
        assert self.process.stdout.readline() == "ready\n", self.said

    def says(self, text):
        wait(lambda: any(text in line for line in self.said), lambda: f"'{text}' is not said, but {self.said}")

    def end(self):
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(10) == 0, self.said


def refuses_bad_options():
    for arguments, environment, text in ((["--namespace=a//b"], {}, "--namespace"), (["--namespace=2a"], {}, "--namespace"), (["--domain=233"], {}, "--domain"),
                                         ([], {"ROS_DOMAIN_ID": "x"}, "ROS_DOMAIN_ID"), (["--needle=-1"], {}, "--needle")):
        done = subprocess.run([BRIDGE, *arguments], env={**os.environ, **environment}, capture_output=True, text=True, timeout=20)
        assert done.returncode == 2 and text in done.stderr, (arguments, environment, done)
    done = subprocess.run([BRIDGE], env={**os.environ, "CYCLONEDDS_URI": "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='none7'/></Interfaces></General></Domain></CycloneDDS>"},
                          capture_output=True, text=True, timeout=20)
    assert done.returncode == 2 and "trocar-dds: CycloneDDS cannot join domain 0" in done.stderr, done


def meets_as_ros_would(peer):
    """Names follow https://design.ros2.org/articles/topic_and_service_names.html; types are named as by rosidl."""
    wanted = {"rt/arm/needle/pose geometry_msgs::msg::dds_::PoseStamped_ best-effort", "rt/arm/needle/wrench geometry_msgs::msg::dds_::WrenchStamped_ best-effort",
              "rt/arm/needle/joint_states sensor_msgs::msg::dds_::JointState_ best-effort"}
    wait(lambda: set(peer.samples["endpoint"]) == wanted, lambda: f"endpoints {peer.samples['endpoint']}")


def rest(peer, network, position, orientation=(0, 0, 0, 1)):
    """Publishes this pose until it has been on LCM for half a second, however late that is on a busy machine."""
    arrived = []

    def stays():
        peer.publish(position, orientation)
        time.sleep(0.01)
        if not arrived and abs(network.poses[-1][2] - position[2]) < 1e-12:
            arrived.append(time.monotonic())
        return arrived and time.monotonic() - arrived[0] > 0.5
    wait(stays, lambda: f"{position} does not arrive, but {network.poses[-1]}")


def drives_a_needle(peer, network):
    """Advances the needle by 30 mm, turned by 0.5 rad, at 100 poses per second."""
    turn = (0, 0, math.sin(0.25), math.cos(0.25))
    wait(lambda: peer.publish(START, turn) or time.sleep(0.01) or network.poses, "no pose reaches the server")
    time.sleep(0.3)
    network.poses.clear()
    published = [(START[0], START[1], START[2] + 0.030 * i / 100) for i in range(101)]
    due = time.monotonic()
    for position in published:
        peer.publish(position, turn)
        due += 0.01
        time.sleep(max(0, due - time.monotonic()))
    last = published[-1]
    rest(peer, network, last, turn)
    heights = [pose[2] for pose in network.poses]
    assert all(a <= b for a, b in zip(heights, heights[1:])), "the needle moves back"
    between = len(set(heights) - {position[2] for position in published})
    print(f"{len(heights)} poses to the server, {between} between those of the 101 published")
    assert between > len(set(heights)) / 2, "the needle jumps from pose to pose"    # also true at low pose rates, as on a busy machine
    for value, wanted in zip(network.poses[-1], (*last, turn[3], *turn[:3])):
        assert abs(value - wanted) < 1e-15, (network.poses[-1], last)
    stamp, frame, pose = peer.samples["pose"][-1]
    assert (frame, pose) == ("world", (*last, *turn)), (frame, pose)


def feels_the_needle(peer, network):
    """Called while the needle is at rest, 29 mm deep. The wrenches are those on LCM, bit for bit, unless the client ramps them after a gap (busy machine).
    Returns the length of the track (m)."""
    place = peer.samples["pose"][-1][2]
    wrenches, joints = peer.samples["wrench"], peer.samples["joint_states"]

    def same():
        peer.publish(place[:3], place[3:])
        time.sleep(0.02)
        on_lcm = set(wrench[:6] for wrench in network.wrenches)
        return all(wrench[2] in on_lcm and wrench[2][2] < -0.1 for wrench in wrenches[-50:])     # at least 0.1 N, because the tissue resists the needle
    wait(same, lambda: f"the wrenches are not those on LCM: {wrenches[-1]}")
    stamp, frame, last = wrenches[-1]
    print(f"{len(wrenches)} wrenches, the last 50 are on LCM; force {last[2]:.4f} N")
    assert frame == "world" and abs(stamp - time.time()) < 5, (stamp, frame)
    by_stamp = {wrench[0]: wrench[2] for wrench in wrenches}    # both messages of a period have the same time stamp
    stamp, frame, names, position, velocity, effort = next(joint for joint in reversed(joints) if joint[0] in by_stamp)
    last = by_stamp[stamp]
    depth = network.wrenches[-1][6]
    assert (frame, names, velocity) == ("world", ["insertion", "roll"], []), joints[-1]
    assert abs(position[0] - depth) < 1e-6 and 0.025 < depth < 0.031, (position, depth)
    assert abs(position[1] - 0.5) < 1e-12, position
    assert abs(effort[0] - last[2]) < 1e-3 and abs(effort[1] - last[5]) < 1e-4, (effort, last)      # the needle points along the world's z
    return depth


def refuses_poses(peer, network, bridge):
    place = peer.samples["pose"][-1][2]
    network.poses.clear()
    for position, orientation, frame, text in ((START, (0, 0, 0, 1), "camera", 'its frame_id is "camera" and not "world"'), (START, (0, 0, 0, 0), "-", "has the norm 0"),
                                               ((math.nan, 0, 0), (0, 0, 0, 1), "-", "not finite"), (START, (0, 0, 0, math.inf), "-", "not finite")):
        peer.publish(position, orientation, frame)
        bridge.says(text)
        peer.publish(place[:3], place[3:])
        time.sleep(1.1)      # at most one line is printed per second
        peer.publish(place[:3], place[3:])
    assert network.poses and all(abs(pose[2] - place[2]) < 1e-12 for pose in network.poses), "a refused pose moves the needle"


def heeds_one_publisher(peer, network, bridge):
    place = peer.samples["pose"][-1][2]
    other = Peer()
    network.poses.clear()
    def both():
        peer.publish(place[:3], place[3:])
        other.publish(START)
        time.sleep(0.01)
        return any("another node publishes poses already" in line for line in bridge.said)
    wait(both, lambda: f"the second publisher is not reported: {bridge.said}")
    assert all(abs(pose[2] - place[2]) < 1e-12 for pose in network.poses), "the second publisher moves the needle"
    other.end()


def releases_the_needle(peer, network, bridge):
    network.commands.clear()
    bridge.says("no poses: the needle is released")
    wait(lambda: 3 in network.commands, "no RELEASE on LCM")
    wait(lambda: peer.samples["wrench"][-1][2] == (0,) * 6, "the last wrench is not zero")
    time.sleep(0.2)
    count = len(peer.samples["wrench"])
    time.sleep(0.3)
    assert len(peer.samples["wrench"]) == count, "wrenches of a needle that is not held"


def respects_quality_of_service(network):
    """As in ROS, a peer with reliable endpoints gets nothing from trocar-dds, which publishes best-effort, but its poses are accepted. A peer in another domain
    is not discovered."""
    reliable, elsewhere = Peer("reliable"), Peer(domain="8")
    network.poses.clear()
    wait(lambda: reliable.publish(START) or time.sleep(0.01) or network.poses, "poses of a reliable publisher are not taken")
    time.sleep(0.5)
    assert not reliable.samples["wrench"] and not reliable.samples["joint_states"], "reliable"
    assert not elsewhere.samples["endpoint"], elsewhere.samples["endpoint"]
    reliable.end()
    elsewhere.end()


def is_coupled(peer, network, rigid):
    """With default options, the needle hangs on the coupling's spring, whose stiffness is at most 400 N/m, and less on a busy machine. So it is less deep than
    without the coupling (`rigid`, m), by the force over the stiffness."""
    bridge = Bridge()
    network.wrenches.clear()
    wait(lambda: peer.publish(START) or time.sleep(0.01) or network.wrenches, "no wrench")
    for i in range(101):
        peer.publish((START[0], START[1], START[2] + 0.030 * i / 100))
        time.sleep(0.01)
    rest(peer, network, (START[0], START[1], START[2] + 0.030))
    wrench, stiffness = network.wrenches[-1], network.stiffness
    lag, force = rigid - wrench[6], -wrench[2]
    print(f"coupled with {stiffness:.0f} N/m: {1e3 * lag:.2f} mm less deep at {force:.4f} N")
    assert force > 0.1 and 0 < stiffness <= 400 and abs(lag * stiffness / force - 1) < 0.3, (force, stiffness, lag)
    assert peer.samples["wrench"][-1][2][2] < -0.1, "no force reaches ROS"
    bridge.end()


def main():
    in_namespace(SOURCE)
    refuses_bad_options()
    network, peer = Network(), Peer()
    bridge = Bridge("--without-force")
    meets_as_ros_would(peer)
    server = subprocess.Popen([f"{BUILD}/server/trocar-server", "--scene", f"{SOURCE}/meshes/figure8.yaml", "--allow-non-rt"], stdout=subprocess.PIPE,
                              stderr=subprocess.DEVNULL, text=True)
    try:
        assert any(line == "ready\n" for line in server.stdout), "the server does not start"
        drives_a_needle(peer, network)
        rigid = feels_the_needle(peer, network)
        refuses_poses(peer, network, bridge)
        heeds_one_publisher(peer, network, bridge)
        releases_the_needle(peer, network, bridge)
        respects_quality_of_service(network)
        bridge.end()
        is_coupled(peer, network, rigid)
        peer.end()
    finally:
        for process in (server, peer.process, bridge.process):
            process.kill()
    print("passed")


main()
