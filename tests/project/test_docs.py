#!/usr/bin/python3
"""Tests the documentation: the site builds without warnings, every link and anchor has a target, and every code block in docs/ and in the READMEs listed below
runs, unless a comment before it says why it cannot (see docs/source.md).

usage: test_docs.py BUILD_DIR SOURCE_DIR
"""
import csv
import html.parser
import importlib.machinery
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.parse
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

SHELL, CODE = {"sh", "bash"}, {"c", "cpp", "csharp", "python", "yaml"}
TEXT = {"text", "json", "csv", "console", "diff"}  # languages of output and diagrams, which cannot be run
BLOCK = re.compile(r"((?:^<!--[^\n]*-->\n\s*)*)^( *)(`{3,})(\w*)[^\n]*\n(.*?)^\2\3 *$", re.MULTILINE | re.DOTALL)
MARK = re.compile(r"<!-- (not run|background|file|declarations)(?:: (.+?))? -->")


class Block:
    def __init__(self, page, match, text):
        self.language, self.line = match[4], text[:match.start(4)].count("\n") + 1
        indent = len(match[2])
        self.code = "".join(line[indent:] for line in match[5].splitlines(keepends=True))
        self.marks = dict(MARK.findall(match[1]))
        self.place = f"{page}:{self.line}"

    def fault(self):
        if self.language not in SHELL | CODE | TEXT:
            return f"{self.place}: language '{self.language}' is not tested: use one of {', '.join(sorted(SHELL | CODE | TEXT))}"
        if "not run" in self.marks and len(self.marks["not run"]) < 10:
            return f"{self.place}: 'not run' needs a reason of at least 10 characters"
        return None


def blocks_of(source, page):
    text = (source / page).read_text()
    return [Block(page, match, text) for match in BLOCK.finditer(text)]


READMES = ("README.md", "clients/view/README.md", "meshes/anatomy/README.md", "tests/fuzz/README.md", "tests/verification/README.md")


def pages_of(source):
    return [*map(Path, READMES), *sorted(path.relative_to(source) for path in (source / "docs").rglob("*.md") if "results" not in path.parts)]


# ---- running the blocks of one page, within a private network namespace -----------------------------------------------------

PYTHON_HOST = """
import sys, traceback
shared = {"__name__": "__main__"}
for request in sys.stdin:
    place, code = eval(request)
    try:
        exec(compile(code, place, "exec"), shared)
        answer = "ok"
    except BaseException:
        answer = repr(traceback.format_exc())
    print("\\nANSWER " + answer, flush=True)
"""


class Page:
    """The folder in which a page's blocks run. It resembles the source folder but has files of its own; the programs are the installed ones."""

    def __init__(self, build, source, prefix, folder):
        self.source, self.prefix, self.folder = source, prefix, folder
        self.python, self.running, self.declarations = None, [], ""
        for entry in source.iterdir():
            if not entry.name.startswith((".", "build", "out")):
                (folder / entry.name).symlink_to(entry)
        (folder / "build").symlink_to(build)
        (folder / "out").mkdir()
        (folder / ".bin").mkdir()
        (folder / ".bin/python3").symlink_to("/usr/bin/python3")
        library = next((prefix / "lib").rglob("libtrocar.so")).parent
        self.environment = dict(os.environ, PATH=f"{folder}/.bin:{prefix}/bin:{os.environ['PATH']}", LC_ALL="C.UTF-8",
                                PKG_CONFIG_PATH=f"{library}/pkgconfig", LD_LIBRARY_PATH=str(library), PYTHONPATH=f"{build}/clients/python",
                                TROCAR_LIBRARY=f"{library}/libtrocar.so", XDG_CACHE_HOME=str(folder / "out"), MPLBACKEND="svg",
                                MPLCONFIGDIR=str(prefix / "matplotlib"))    # one font cache for all pages

    def run(self, block):
        """Returns a description of the fault, or None if there is none."""
        code = block.code.replace("/usr/share/trocar", f"{self.prefix}/share/trocar").replace("/usr/share/doc/trocar", f"{self.prefix}/share/doc/trocar")
        if "file" in block.marks:
            (self.folder / block.marks["file"]).write_text(code)
        if "declarations" in block.marks:
            self.declarations += code
            return None
        if block.language in SHELL:
            return self.start(code) if "background" in block.marks else self.shell(code)
        if block.language == "csharp":
            return None     # not run here: a command on the page compiles it
        return {"c": self.compile, "cpp": self.compile, "python": self.interpret, "yaml": self.load}[block.language](block, code)

    def shell(self, code):
        state = self.folder / ".environment"
        script = f"set -euo pipefail; [ ! -e {state} ] || source {state}\n{code}\nexport -p >{state}"
        return self.command(["bash", "-c", script])

    def command(self, command):
        try:
            done = subprocess.run(command, cwd=self.folder, env=self.environment, text=True, timeout=50, stdin=subprocess.DEVNULL,
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        except subprocess.TimeoutExpired as late:
            return f"not done in 50 s: mark the block as background if it should go on\n{(late.stdout or b'').decode()}"
        return f"status {done.returncode}\n{done.stdout}" if done.returncode != 0 else None

    def start(self, code):
        """Runs the block in the background and waits until it prints `ready`."""
        output = open(self.folder / f".output{len(self.running)}", "w+")
        process = subprocess.Popen(["bash", "-c", code], cwd=self.folder, env=self.environment, start_new_session=True, stdin=subprocess.DEVNULL,
                                   stdout=output, stderr=subprocess.STDOUT)
        self.running.append(process)
        for _ in range(400):
            text = Path(output.name).read_text()
            if re.search("^ready$", text, re.MULTILINE):
                return None
            if process.poll() is not None:
                return f"ended before it was ready\n{text}"
            time.sleep(0.05)
        return f"not ready in 20 s\n{text}"

    def compile(self, block, code):
        cpp = block.language == "cpp"
        path = self.folder / f"block{block.line}.{'cpp' if cpp else 'c'}"
        path.write_text(code)
        flags = subprocess.run(["pkg-config", "--cflags", "--libs", "trocar-client", "trocar"], env=self.environment, capture_output=True, text=True)
        whole = re.search(r"\bmain\(", code) is not None
        return self.command(["c++" if cpp else "cc", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "-I.", "-Idocs/examples",
                             *(["-o", f"block{block.line}"] if whole else ["-fsyntax-only"]), path.name, *flags.stdout.split()])

    def declare(self):
        """Compiles all declarations of a page together."""
        (self.folder / "declarations.c").write_text("#include <stddef.h>\n#include <stdint.h>\n" + self.declarations)
        return self.command(["cc", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "declarations.c"])

    def interpret(self, block, code):
        """Runs the block in the page's interpreter, as if a reader had typed it."""
        if self.python is None:
            self.python = subprocess.Popen(["/usr/bin/python3", "-c", PYTHON_HOST], cwd=self.folder, env=self.environment, text=True,
                                           stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        self.python.stdin.write(repr((block.place, code)) + "\n")
        self.python.stdin.flush()
        said = []
        for line in self.python.stdout:
            if line.startswith("ANSWER "):
                answer = line[7:].strip()
                return None if answer == "ok" else eval(answer)
            said.append(line)
        return "the interpreter died\n" + "".join(said)

    def load(self, block, code):
        """Creates a model if the YAML is a scene; otherwise only parses it."""
        if not re.search("^mesh:", code, re.MULTILINE):
            return self.command(["/usr/bin/python3", "-c", "import sys, yaml; yaml.safe_load(sys.argv[1])", code])
        mesh = re.search(r"^mesh: *(\S+)", code, re.MULTILINE)[1]
        if not (self.folder / mesh).exists() and (self.source / "meshes" / mesh).exists():
            shutil.copy(self.source / "meshes" / mesh, self.folder / mesh)
        path = self.folder / block.marks.get("file", f"block{block.line}.yaml")
        path.write_text(code)
        return self.command(["/usr/bin/python3", "-c", "import sys, trocar; trocar.Model(trocar.Scene.load(sys.argv[1]))", path.name])

    def end(self):
        for process in self.running:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)
                process.wait()
        if self.python is not None:
            self.python.kill()


def run_page(build, source, prefix, page):
    """Runs the blocks of one page in order. Returns the exit status."""
    with tempfile.TemporaryDirectory() as folder:
        site = Page(build, source, prefix, Path(folder))
        try:
            for block in blocks_of(source, page):
                if block.language in TEXT or "not run" in block.marks:
                    continue
                begin = time.monotonic()
                fault = site.run(block)
                if fault is not None:
                    print(f"{block.place}: {fault}\n{block.code}", file=sys.stderr)
                    return 1
                print(f"{block.place} {block.language} {time.monotonic() - begin:.1f} s")
            fault = site.declare()
            if fault is not None:
                print(f"{page}: {fault}", file=sys.stderr)
                return 1
        finally:
            site.end()
    return 0


# ---- the tests ------------------------------------------------------------------------------------------------------------------

class Site(html.parser.HTMLParser):
    """The anchors, links and resources of a built page."""

    def __init__(self, text):
        super().__init__()
        self.anchors, self.links, self.resources = set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        a = dict(attributes)
        self.anchors.update(v for k, v in a.items() if k in ("id", "name") and v)
        if tag == "a" and a.get("href"):
            self.links.append(a["href"])
        for key in ("src", "href"):
            if a.get(key) and tag in ("img", "script", "link", "iframe") and a.get("rel") != "canonical":
                self.resources.append(a[key])


def check_site(source, out):
    """Builds the site. Returns the faults."""
    done = subprocess.run([source / "scripts/docs", out], capture_output=True, text=True)
    if done.returncode != 0 or done.stderr:
        return [f"scripts/docs: status {done.returncode}\n{done.stdout}{done.stderr}"]
    pages = {path: Site(path.read_text()) for path in out.rglob("*.html")}
    # Python-Markdown would take the two asterisks in "X* ... X*" as emphasis.
    faults = [f"{path.relative_to(out)}: accidental emphasis: {match[0]}" for path in pages for match in re.finditer(r"<em>(\s[^<]*|[^<]*\s)</em>", path.read_text())]
    count = 0
    for path, page in pages.items():
        if path.name == "404.html":
            continue
        for resource in page.resources:
            if re.match(r"(https?:)?//", resource):
                faults.append(f"{path.relative_to(out)} loads {resource} from the network")
        for link in page.links + page.resources:
            target = urllib.parse.urlsplit(link)
            if target.scheme or link == "#" or link.startswith("#__"):
                continue
            count += 1
            file = Path(os.path.normpath(path.parent / urllib.parse.unquote(target.path))) if target.path else path
            file = file / "index.html" if file.is_dir() else file
            if not file.is_file():
                faults.append(f"{path.relative_to(out)} links to {link}, which does not exist")
            elif target.fragment and file in pages and urllib.parse.unquote(target.fragment) not in pages[file].anchors:
                faults.append(f"{path.relative_to(out)} links to {link}: no such anchor")
    print(f"site: {len(pages)} pages, {count} links")
    return faults


def github_anchors(text):
    """Returns the anchors that GitHub generates for headings."""
    headings = re.findall(r"^#+ +(.+?) *#*$", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)
    plain = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).replace("`", "") for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in plain}


def check_links(source, docs):
    """Checks links between the documents in the repository, anchors included. Returns the faults."""
    faults, count = [], 0
    for page in docs.documents():
        if page.suffix != ".md":
            continue
        for link in docs.links((source / page).read_text()):
            target, _, anchor = link.partition("#")
            if ":" in target:
                continue
            count += 1
            file = Path(os.path.normpath(source / page.parent / target)) if target else source / page
            if not file.is_file():
                faults.append(f"{page} links to {link}, which is not a file")
            elif anchor and file.suffix == ".md" and anchor not in github_anchors(file.read_text()):
                faults.append(f"{page} links to {link}: no such heading")
    print(f"documents: {count} links")
    return faults


def check_blocks(source):
    """Checks markers and languages. Returns the faults, and the numbers of blocks that are run and that are not."""
    faults, run, excused = [], 0, 0
    for page in pages_of(source):
        blocks = blocks_of(source, page)
        faults += [fault for fault in (block.fault() for block in blocks) if fault]
        code = [block for block in blocks if block.language not in TEXT]
        excused += sum("not run" in block.marks for block in code)
        run += sum("not run" not in block.marks for block in code)
        text = BLOCK.sub("\n", (source / page).read_text())
        for match in re.finditer(r"(?:\A|\n)(?P<before>[^\n]*)\n\n    (?P<code>\S[^\n]*)", text):
            if not re.match(r" *([-*+]|\d+\.) |  ", match["before"]):
                faults.append(f"{page}: an indented block is not tested, use ``` instead: {match['code']}")
    return faults, run, excused


def check_examples(source):
    """Compiles the device bridges against the headers in tests/project/standins, for Linux and, with the compilers that are installed, for Windows. Returns the
    faults."""
    faults, windows = [], "x86_64-w64-mingw32-"
    for path in sorted((source / "docs/examples").glob("bridge*.c*")):
        names, standard = (("c++", windows + "g++"), "c++17") if path.suffix == ".cpp" else (("cc", windows + "gcc"), "gnu17")
        for compiler in filter(shutil.which, names):
            done = subprocess.run([compiler, f"-std={standard}", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only", f"-I{source}/tests/project/standins",
                                   f"-I{source}/clients/client", path], capture_output=True, text=True)
            if done.returncode != 0:
                faults.append(f"{path.name} with {compiler}:\n{done.stderr}")
    return faults


def check_readme(source):
    """Checks the length of README.md and that it shows docs/examples/bridge.c. Returns the faults."""
    text = (source / "README.md").read_text()
    faults = [] if len(text.split()) < 700 else [f"README.md has {len(text.split())} words; keep it below 700"]
    if (source / "docs/examples/bridge.c").read_text() not in [block.code for block in blocks_of(source, Path("README.md"))]:
        faults.append("README.md does not show docs/examples/bridge.c")
    return faults


def check_quoted(source):
    """Checks that numbers given in several documents agree with the data or with each other. Returns the faults."""
    text = lambda name: (source / name).read_text()
    table = lambda name: list(csv.DictReader(text(f"tests/verification/results/{name}.csv").splitlines()))
    rate = max(float(row["value"]) for row in table("independence") if re.fullmatch(r"\d+ Hz: force", row["check"]))
    judged = [row["pass"] for run in table("runs") for row in table(run["check"]) if row["pass"]]
    median = next(row for row in table("needle_meshes") if row["check"].startswith("median of all "))
    rows = [row for row in json.loads(text("docs/results/tick/tick.json"))["rows"] if row["contacts"] == 30]
    tick, slow = (1e6 * max(row[key] for row in rows) for key in ("p50_s", "p99_s"))
    large = {row["quantity"]: row["high"] for row in csv.DictReader(text("docs/results/scale/large-meshes.csv").splitlines()) if row["nodes"] == "44987"}
    restart, memory = large["later start"], large["server after a later start: resident memory"]
    least, most = re.search(r"degrees in the coronal plane \((-[\d.]+) to \+([\d.]+)\)", text("docs/seeds.md")).groups()
    remesh = dict(re.findall(r"^(inside|face) +nested .* Woodbury takes +([\d.]+) times", text("docs/results/remesh/remesh.txt"), re.MULTILINE))
    numbers, tendencies = re.findall(r"^- \*\*(\d+ of \d+)\*\* predictions of", text("tests/validation/REPORT.md"), re.MULTILINE)
    quoted = (("docs/faq.md", f"differ by {100 * rate:.2f} % of the peak at most"),
              ("docs/results/README.md", f"within {100 * rate:.2f} % of the peak"),
              ("docs/results/README.md", f"p50 {tick:.0f} us, p99 {slow:.0f} us"),
              ("README.md", f"| {tick:.0f} us (p99: {slow:.0f} us), Intel Xeon"),
              ("README.md", f"{float(remesh['face']):.0f} to {float(remesh['inside']):.0f} times faster than a dense update at 572 nodes"),
              ("README.md", f"{judged.count('yes')} of {len(judged)} rows pass; median error of {median['check'].split()[3]} forces "
                            f"{100 * float(median['value']):.1f} %"),
              ("README.md", f"{numbers} predicted numbers and {tendencies} tendencies are as published"),
              ("README.md", f"restarts in {float(restart):.0f} s and takes [{float(memory):.0f} GB]"),
              ("docs/make-a-scene.md", f"to {restart} s, 0.81 to {memory} GB"),
              ("docs/validation.md", f"{least} to {most} while needles go in and out"))
    return [f"{page}: does not say \"{words}\", as the data do" for page, words in quoted if words not in text(page)]


def load_script(path):
    loader = importlib.machinery.SourceFileLoader(path.name, str(path))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(path.name, loader))
    loader.exec_module(module)
    return module


def main(arguments):
    build, source = Path(arguments[0]), Path(arguments[1])
    if len(arguments) == 4:
        return run_page(build, source, Path(arguments[2]), Path(arguments[3]))
    sys.dont_write_bytecode = True
    docs = load_script(source / "scripts/docs")
    faults, run, excused = check_blocks(source)
    faults += check_readme(source) + check_quoted(source) + check_links(source, docs) + check_examples(source)

    netns = source / "scripts/netns"
    private = subprocess.run([netns, "true"], capture_output=True).returncode == 0
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as pool:
        site = pool.submit(check_site, source, Path(folder) / "html")
        prefix = Path(folder) / "usr"
        installed = subprocess.run(["cmake", "--install", build, "--prefix", prefix], capture_output=True, text=True)
        if installed.returncode != 0:
            faults.append(installed.stdout + installed.stderr)
        elif private:
            commands = [[netns, sys.executable, __file__, build, source, prefix, page] for page in pages_of(source)]
            for done in pool.map(lambda command: subprocess.run(command, capture_output=True, text=True), commands):
                print(done.stdout, end="")
                if done.returncode != 0:
                    faults.append(done.stderr)
        faults += site.result()
    print(f"{run} blocks run, {excused} marked with a reason why not")
    for fault in faults:
        print(f"FAILED: {fault}", file=sys.stderr)
    if not faults and not private:
        print("code blocks not run: no network namespace here")
        return 77
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
