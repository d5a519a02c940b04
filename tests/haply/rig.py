"""Server, bridge and stand-in for tests, in a private network namespace."""
import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

from standin import Service


def in_namespace(script, arguments, source):
    """Runs this script again inside a private network namespace; exits with status 77 where that is not permitted."""
    if os.environ.get("TROCAR_HAPLY_INSIDE"):
        return
    netns = f"{source}/scripts/netns"
    if subprocess.run([netns, "true"]).returncode != 0:
        sys.exit(77)
    os.environ["TROCAR_HAPLY_INSIDE"] = "1"
    os.execv(netns, [netns, sys.executable, script, *arguments])


def wait_for(condition, what, seconds=5.0):
    end = time.monotonic() + seconds
    while not (found := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"timed out after {seconds} s: {what}")
        time.sleep(0.002)
    return found


class Rig:
    def __init__(self, build, source, folder, **service):
        self.build, self.source, self.folder = Path(build), Path(source), Path(folder)
        self.scene = self.source / "meshes/figure8.yaml"
        self.service = Service(**service)
        self.bridge = self.server = None

    def start_server(self):
        log = open(self.folder / "server", "w+")
        self.server = subprocess.Popen([self.build / "server/trocar-server", "--scene", self.scene, "--allow-non-rt"], stdout=log, stderr=subprocess.STDOUT)
        wait_for(lambda: re.search("^ready$", Path(log.name).read_text(), re.MULTILINE), "the server is not ready", 20)

    def start_bridge(self, *options):
        self.out, self.said_file = self.folder / "bridge.out", self.folder / "bridge.err"
        self.bridge = subprocess.Popen([self.build / "clients/bridges/haply/trocar-haply", "--service", f"127.0.0.1:{self.service.port}", "--events", "0",
                                        *options], stdout=open(self.out, "w"), stderr=open(self.said_file, "w"))
        wait_for(lambda: self.service.forces, "the bridge sends nothing: " + self.said())

    def said(self):
        return self.said_file.read_text()

    def stop_bridge(self):
        self.bridge.send_signal(signal.SIGTERM)
        return self.bridge.wait(10)

    def kill_server(self):
        self.server.kill()
        self.server.wait()

    def end(self):
        for process in (self.bridge, self.server):
            if process and process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.terminate()
                try:
                    process.wait(10)
                except subprocess.TimeoutExpired:
                    process.kill()
        self.service.stop()

    def force(self):
        """The newest force, device's frame, N."""
        return self.service.forces[-1][1]

    def since(self, start):
        """[(time, force)] that were received after this time."""
        forces, k = self.service.forces, len(self.service.forces)
        while k > 0 and forces[k - 1][0] >= start:
            k -= 1
        return [(at, force) for at, force, _ in forces[k:]]

    def norms_since(self, start):
        return [math.hypot(*force) for _, force in self.since(start)]

    def wait_for_force(self, least, what):
        return wait_for(lambda: math.hypot(*self.force()) > least, f"{what}: {self.force()} N; {self.said()}")
