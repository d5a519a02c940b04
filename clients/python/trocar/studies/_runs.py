"""Executes the runs of a study, each in its own process, and appends their results to a file that stays usable even if a process is killed."""
from __future__ import annotations

import csv
import errno
import fcntl
import gc
import io
import json
import os
import selectors
import signal
import sys
import time
import zlib
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from .. import Error, Model, Sim
from ._definition import BadStudy, Study
from .._files import open_input, open_regular, replacing
from ._quantities import Recording
from ..brachy.plan import BadPlan

FEW = 8          # below this many runs per stiffness, the sparse inverse is faster overall, because it is faster to build
SYNC = 1.0       # s, minimum time between fsync calls
NOTHING = float("nan")


class Row(NamedTuple):
    """The results of a finished run."""

    index: int
    status: str                # "ok", or the reason why the run failed
    parameters: tuple[float, ...]
    results: tuple[float, ...]  # NaN where a result is missing


# ---- one run ------------------------------------------------------------------------------------------------------------------------------


def _chunks(poses: npt.NDArray[np.float64], tick: int, stops: Sequence[int]) -> Iterator[npt.NDArray[np.float64]]:
    """Splits poses, the first of which belongs to `tick`, after each tick in `stops`."""
    cuts = [stop + 1 - tick for stop in stops if tick <= stop < tick + len(poses)]
    for first, last in zip([0, *cuts], [*cuts, len(poses)]):
        if last > first:
            yield poses[first:last]


def run(study: Study, values: npt.NDArray[np.float64], model: Model, scene: Any, frames: Any = None) -> list[float]:
    """Does one run and returns the recorded numbers. Raises Error, BadPlan."""
    dt = 1.0 / model.rate_hz
    recording = Recording(Sim(model), scene, dt, study.plan)
    results: dict[int, list[float]] = {}
    wanted = {i: round(measure.at / dt) for i, measure in enumerate(study.measures) if measure.at is not None}
    every = round(study.frames_every / dt)
    tick = 0

    def stops_from(start: int, count: int) -> list[int]:
        of_frames = range(-(-start // every) * every, start + count, every) if frames is not None else ()
        return sorted({*wanted.values(), *of_frames})

    recording.moves = study.run_motion(values).moves(recording.sim, dt)
    for needle, poses in recording.moves:
        for chunk in _chunks(poses, tick, stops_from(tick, len(poses))):
            recording.poses.append(chunk)
            recording.outputs.append(recording.sim.run(chunk, dt, needle))
            recording.moved()
            tick += len(chunk)
            for i, at in wanted.items():
                if at == tick - 1:
                    results[i] = study.measures[i].quantity.measure(recording, study.measures[i].option)
            if frames is not None and (tick - 1) % every == 0:
                frames.add((tick - 1) * dt, recording)
    for i, measure in enumerate(study.measures):
        if measure.at is None:
            results[i] = measure.quantity.measure(recording, measure.option)
    return [number for i, measure in enumerate(study.measures) for number in results.get(i, [NOTHING] * len(measure.quantity.parts))]


# ---- models ---------------------------------------------------------------------------------------------------------------------------------


class Groups(NamedTuple):
    """Groups of runs that share a stiffness. All tasks of a study compute the same groups, so results do not depend on which task does a run."""

    of_run: npt.NDArray[np.int64]   # (runs,) index of the group to which each run belongs
    sparse: bool                    # true if the models use the sparse inverse


def groups_of(study: Study, samples: npt.NDArray[np.float64]) -> Groups:
    columns = study.stiffness_columns()
    if not columns:
        return Groups(np.zeros(len(samples), np.int64), False)
    _, of_run = np.unique(samples[:, columns], axis=0, return_inverse=True)
    of_run = of_run.reshape(-1)
    if study.method == "random":    # runs may be added later, so the results of finished runs must not depend on the final number of runs
        few = study.possible_stiffnesses() > FEW
    else:
        few = len(samples) < FEW * (of_run.max() + 1)
    return Groups(of_run, few and study.inverse == "auto")


def runs_of_task(groups: Groups, task: tuple[int, int]) -> list[int]:
    """Returns the runs of task i of N, in execution order. Runs with the same stiffness stay together, so that each model is built in as few tasks as
    possible."""
    order = np.argsort(groups.of_run, kind="stable")
    i, count = task
    return (np.array_split(order, count)[i - 1] if groups.of_run.any() else order[i - 1::count]).tolist()


def model_of(study: Study, values: npt.NDArray[np.float64], base: Model | None, sparse: bool) -> tuple[Model, Any]:
    """Returns the model for one run, derived from `base` if that has the same stiffness."""
    scene = study.run_scene(values, sparse)
    if base is not None:
        try:
            return base.derive(scene), scene
        except Error as error:
            if error.status != "bad input":
                raise
    return Model(scene), scene


# ---- rows in files --------------------------------------------------------------------------------------------------------------------------


def line_of(cells: Iterable[Any]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def checked(line: str) -> bytes:
    """Appends a cell with the line's CRC-32, as in the rows of a task's file."""
    cells = line.rstrip("\n").encode()
    return cells + b",%08x\n" % zlib.crc32(cells)


def cells_of(row: Row) -> list[Any]:
    return [row.index, row.status, *map(repr, row.parameters), *map(repr, row.results)]


def heading(study: Study) -> list[str]:
    return ["run", "status", *study.parameter_columns(), *study.result_columns()]


def read_rows(path: Path, study: Study, samples: npt.NDArray[np.float64]) -> list[Row]:
    """Returns the complete rows in a task's file. Raises BadStudy if they do not belong to this study and these samples."""
    with open_input(path, "rb") as file:
        return _parse_rows(path, file.read(), study, samples)[0]


def _parse_rows(path: Path, data: bytes, study: Study, samples: npt.NDArray[np.float64]) -> tuple[list[Row], int]:
    """Returns the complete rows, and the number of bytes up to the end of the last one, including the heading. Any bytes after that are a partial row, left
    when the process was killed."""
    end = data.rfind(b"\n") + 1
    if end == 0:
        return [], 0
    first, *lines = data[:end].split(b"\n")[:-1]
    columns = heading(study)
    if first + b"\n" != checked(line_of(columns)):
        raise BadStudy(f"{path}:1: rows of another study: choose another folder with --out")
    rows, parameters = [], len(study.parameters)
    for number, line in enumerate(lines, 2):
        try:
            line, _, check = line.rpartition(b",")
            if check != b"%08x" % zlib.crc32(line):
                raise ValueError
            cells, = csv.reader([line.decode("utf-8")])
            if len(cells) != len(columns):
                raise ValueError
            numbers = tuple(map(float, cells[2:]))
            row = Row(int(cells[0]), cells[1], numbers[:parameters], numbers[parameters:])
        except (ValueError, csv.Error):
            raise BadStudy(f"{path}:{number}: damaged or changed since it was written: remove the line, and the run is repeated") from None
        if study.method == "random" and row.index >= len(samples):    # written when the study had more runs
            continue
        if not 0 <= row.index < len(samples) or row.parameters != tuple(samples[row.index].tolist()):
            raise BadStudy(f"{path}:{number}: run {row.index} has other parameters than the study: choose another folder with --out")
        rows.append(row)
    return rows, end


def _read_whole(file: int, size: int) -> bytes:
    """Reads the first `size` bytes of a file. Loops because one pread call returns at most 2 GiB."""
    data = bytearray()
    while len(data) < size:
        part = os.pread(file, size - len(data), len(data))
        if not part:
            raise OSError(errno.EIO, "the file is shorter than its size")
        data += part
    return bytes(data)


class TaskFile:
    """The file that a task appends its rows to. It is open and locked."""

    def __init__(self, path: Path, study: Study, samples: npt.NDArray[np.float64]):
        self.path = path
        self._file = open_regular(path, os.O_RDWR | os.O_CREAT | os.O_APPEND)
        try:
            self._lock()
            size = os.fstat(self._file).st_size
            # Read through the locked descriptor: opening the file again and closing it would release the lock.
            self.rows, end = _parse_rows(path, _read_whole(self._file, size), study, samples)
            self.torn = size - end    # bytes
            os.ftruncate(self._file, end)
            if end == 0:
                os.write(self._file, checked(line_of(heading(study))))
        except BaseException:
            os.close(self._file)
            raise
        self._synced = 0.0

    def _lock(self) -> None:
        try:
            fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            raise BadStudy(f"{self.path}: another process is working on this task: wait for it, or stop it") from None
        except OSError as error:
            raise BadStudy(f"{self.path}: cannot be locked: {error.strerror}: choose with --out a folder on a file system that supports locks") from None

    def append(self, row: Row) -> None:
        """Appends a row. Once this returns, the row is safe even if the process is killed. To make rows survive a power failure too, it also calls fsync, but
        at most once every SYNC seconds."""
        data = checked(line_of(cells_of(row)))
        if os.write(self._file, data) != len(data):
            raise OSError(28, "No space left on device", str(self.path))
        if time.monotonic() - self._synced > SYNC:
            self.sync()

    def sync(self) -> None:
        os.fsync(self._file)
        self._synced = time.monotonic()

    def close(self) -> None:
        self.sync()
        os.close(self._file)


# ---- processes ------------------------------------------------------------------------------------------------------------------------------


def _child(write: int, work: Callable[[], Any], program: str) -> None:
    """Body of the child process: does the work, sends the outcome to the parent, and exits."""
    status = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)     # Ctrl-C also reaches the parent, which then kills its children
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        with os.fdopen(write, "wb") as pipe:
            pipe.write(json.dumps(work()).encode())
        status = 0
    except BaseException as error:  # noqa: BLE001    no exception may escape from the child
        print(f"{program}: {type(error).__name__}: {error}", file=sys.stderr)
    finally:
        sys.stderr.flush()
        os._exit(status)


class Pool:
    """A pool of up to `workers` forked child processes, each of which does one run. A child inherits its parent's objects, such as a model, without copying
    them, and is isolated from other runs."""

    def __init__(self, workers: int, finished: Callable[[int, Any, str], None], program: str = "trocar-study"):
        """finished(run, outcome, why) is called for each run. The outcome has been through JSON; it is None if the child died without sending one, and `why`
        then says why."""
        self.workers, self.finished, self.program = workers, finished, program
        self._running: dict[int, tuple[int, int, bytearray]] = {}    # run, process and received bytes, by the read end of the pipe
        self._selector = selectors.DefaultSelector()

    def start(self, run_: int, work: Callable[[], Any]) -> None:
        while len(self._running) >= self.workers:
            self.wait()
        read, write = os.pipe()
        process = os.fork()
        if process == 0:
            os.close(read)
            _child(write, work, self.program)
        os.close(write)
        self._running[read] = (run_, process, bytearray())
        self._selector.register(read, selectors.EVENT_READ)

    def wait(self) -> None:
        """Waits until at least one child has sent data or exited, and handles that."""
        for key, _ in self._selector.select():
            data = os.read(key.fd, 1 << 16)
            run_, process, received = self._running[key.fd]
            if data:
                received += data
                continue
            self._selector.unregister(key.fd)
            os.close(key.fd)
            del self._running[key.fd]
            status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
            outcome = json.loads(received) if status == 0 else None
            self.finished(run_, outcome, f"signal {-status}" if status < 0 else f"status {status}")

    def join(self) -> None:
        while self._running:
            self.wait()

    def kill(self) -> None:
        """Kills all children."""
        for _, process, _ in self._running.values():
            os.kill(process, signal.SIGKILL)
        for _, process, _ in self._running.values():
            os.waitpid(process, 0)
        self._running.clear()


# ---- a task -----------------------------------------------------------------------------------------------------------------------------------


def task_path(out: Path, task: tuple[int, int]) -> Path:
    return out / "rows-{}-of-{}.csv".format(*task)


def row_files(out: Path) -> list[Path]:
    return sorted(out.glob("rows-*-of-*.csv"))


def check_manifest(study: Study, out: Path) -> None:
    """Writes the study's manifest or, if there already is one, checks that it is the same. Raises BadStudy if the folder belongs to another study."""
    path, own = out / "study.json", study.manifest()
    if path.exists():
        try:
            with open_input(path, encoding="utf-8") as file:
                there = dict(json.load(file))
        except (ValueError, TypeError):
            raise BadStudy(f"{path}: not as trocar-study wrote it: choose another folder with --out") from None
        different = [key for key in sorted({*own, *there}) if own.get(key) != there.get(key)]
        for key in different[:1]:
            values = f" ({there.get(key, 'unknown')} there, {own.get(key, 'unknown')} now)" if key in ("frames", "version") else ""
            remedy = "run it with or without --record frames as before, or " if different == ["frames"] else ""
            raise BadStudy(f"{path}: {out} has results of another study: \"{key}\" differs{values}: {remedy}choose another folder with --out")
        return
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(own, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def has_frames(out: Path) -> bool:
    """Whether the study records frames, according to the manifest in this folder."""
    try:
        with open_input(out / "study.json", encoding="utf-8") as file:
            return dict(json.load(file)).get("frames", "none") != "none"
    except (OSError, ValueError, TypeError):    # check_manifest reports the problem
        return False


class Outcome(NamedTuple):
    done: int        # number of runs completed by this call
    before: int      # number of runs that were already complete
    failed: int      # number of this task's rows whose status is not "ok"
    lost: list[str]  # runs that died without producing a row, and why


def carry_out(study: Study, out: Path, task: tuple[int, int], workers: int, progress: Callable[[int, int], None], say: Callable[[str], None]) -> Outcome:
    """Does those runs of task i of N that are not in any file yet. Reports progress as (done, of)."""
    out.mkdir(parents=True, exist_ok=True)
    check_manifest(study, out)
    samples = study.samples()
    own = task_path(out, task)
    done = {row.index for path in row_files(out) if path != own for row in read_rows(path, study, samples)}
    file = TaskFile(own, study, samples)
    done.update(row.index for row in file.rows)
    if file.torn:
        say(f"{file.path}: dropped the incomplete last line of an interrupted run")
    groups = groups_of(study, samples)
    mine = runs_of_task(groups, task)
    left = [index for index in mine if index not in done]
    before, count, failed, lost = len(mine) - len(left), 0, 0, []
    failed += sum(row.status != "ok" for row in file.rows)
    if study.frames_every:
        from . import frames as _frames    # must be imported before the first child starts
        (out / "frames").mkdir(exist_ok=True)
        say(_frames.size_in_words(study, out))

    def finished(index: int, outcome: tuple[str, list[float]] | None, why: str) -> None:
        nonlocal count, failed
        if outcome is None:
            lost.append(f"run {index}: {why}")
            return
        status, results = outcome
        file.append(Row(index, status, tuple(samples[index].tolist()), tuple(results)))
        count += 1
        failed += status != "ok"
        progress(before + count, before + len(left))

    def work(index: int, base: Model | None) -> Callable[[], tuple[str, list[float]]]:
        def one() -> tuple[str, list[float]]:
            try:
                model, scene = model_of(study, samples[index], base, groups.sparse)
                if not study.frames_every:
                    return "ok", run(study, samples[index], model, scene)
                with _frames.Writer(out / "frames" / f"{index:07d}.h5", model) as frames:
                    return "ok", run(study, samples[index], model, scene, frames)
            except (Error, BadPlan) as error:
                if isinstance(error, Error) and error.status in ("no memory", "system"):    # not the fault of this run, so it can be repeated later
                    raise
                return " ".join(str(error).split()), [NOTHING] * len(study.result_columns())
        return one

    pool = Pool(workers, finished)
    progress(before, before + len(left))
    gc.collect()
    gc.freeze()    # keeps the garbage collector from writing to objects shared with the children, which would copy their memory
    try:
        group, base = -1, None
        remaining = np.bincount(groups.of_run[left]) if left else []    # number of runs left in each group
        for index in left:
            if groups.of_run[index] != group:
                group, base = groups.of_run[index], None
            if base is None and remaining[group] > 1:    # a single remaining run builds its own model, in parallel with other runs
                try:
                    base = Model(study.run_scene(samples[index], groups.sparse))
                except Error:    # the run itself will report the error; try the next one
                    pass
            remaining[group] -= 1
            pool.start(index, work(index, base))
        pool.join()
    finally:
        pool.kill()
        file.close()
    return Outcome(count, before, failed, lost)
