"""Damaged files: what disks, other programs and strangers may make of soft bodies and logs.

A file is made of its seed: a good one, of which some arrays, messages, facts or attachments are others, or some of its
bytes. The command line reads it in a process of its own. What may come of it is what comes of a good file, or one
sentence: no traceback, and no process that dies.

python -m benchmarks.stability.damage
"""

from __future__ import annotations

import io
import json
import lzma
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import cache, partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.stability.abuse import SCENE, soft_body
from benchmarks.stability.apart import Report, reports, told
from mjframes.app.log.options import Log
from mjframes.app.run import record
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code
from mjframes.cli.commands import main as command
from mjframes.scene.attach import attach
from mjframes.scene.packed import NUMBERS, numbers_of

BODIES, LOGS = 500, 600  # files of each
KINDS = 8  # of good bodies
SENTENCE = re.compile(r"mjframes: \S[^\n]*[^.\s]\.\n")
EXTREME = (0, 1, -1, 7, 2**31 - 1, -(2**31), 10**8, 2**62, np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300)
TOKENS = ("0", "-1", "1e999", "nan", "99999999999", "", "x", "../../etc/passwd", "/dev/zero", "1 2 3", "é", "true")
TREES: tuple[Any, ...] = (
    None,
    "x",
    [],
    {},
    True,
    [[]],
    ["x"],
    [None],
    10**400,
    -1,
    1e308,
    0,
    [0.0],
    [1e308] * 9,
    [[0.0]],
)

Rng = np.random.Generator
Arrays = dict[str, NDArray[Any]]


def main(argv: Sequence[str] | None = None) -> int:
    """Read as many damaged files as are asked for, print what became of them; return the exit code."""
    parser = Parser(prog="python -m benchmarks.stability.damage", description="Read damaged soft bodies and logs.")
    parser.add_argument("--bodies", type=int, default=BODIES, help=f"how many (default: {BODIES})")
    parser.add_argument("--logs", type=int, default=LOGS, help=f"how many (default: {LOGS})")
    parser.add_argument("--seed", type=int, default=0, help="the first (default: 0)")
    given = parser.parse_args(argv)
    report = Report()
    for program, count in ((of_body, given.bodies), (of_log, given.logs)):
        for one in reports(program, range(given.seed, given.seed + count), 1):
            report += one
    return told(report, f"{given.bodies} damaged soft bodies and {given.logs} damaged logs")


def of_body(seed: int) -> Report:
    """Return what becomes of the soft body of a seed: it is built into a scene, which is run."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        path, scene, output = (Path(folder) / name for name in ("body.npz", "scene.xml", "all.xml"))
        path.write_bytes(damaged_body(rng, _body(int(rng.integers(KINDS)))))
        scene.write_text(SCENE)
        built = ["build", str(path), "--into", str(scene), "--name", "soft", "-o", str(output)]
        return _tried(f"body {seed}", [built, ["run", str(output), "--duration", "0.01"]])


def of_log(seed: int) -> Report:
    """Return what becomes of the log of a seed: a state of it is printed, and it is plotted or filmed."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        path.write_bytes(damaged_log(rng, _log()))
        again = ["replay", str(path)]
        drawn = (
            ["--video", f"{folder}/a.mp4", "--size", "32x32"] if rng.random() < 0.5 else ["--plot", f"{folder}/a.png"]
        )
        return _tried(f"log {seed}", [[*again, "--state", "0.01"], [*again, *drawn]])


def _tried(what: str, commands: Iterable[list[str]]) -> Report:
    """What comes of commands, of which one that fails is the last."""
    failures, said = [], Counter[str]()
    for words in commands:
        errors, status = io.StringIO(), 0
        try:
            with redirect_stdout(io.StringIO()), redirect_stderr(errors):
                status = command(words)
        except BaseException as error:
            failures.append(f"{what}: {words[0]} raises {type(error).__name__} ({' '.join(str(error).split())}).")
            break
        text = errors.getvalue()
        lines = text.splitlines(keepends=True)
        if status not in (0, 2) or not all(map(SENTENCE.fullmatch, lines)) or (status == 2 and not lines):
            failures.append(f"{what}: {words[0]} ends with {status} and {text!r}.")
        said["taken" if status == 0 else re.sub(r"\S*/\S+|\W?\d[\d.e+]*", "…", text)[:80].strip()] += 1
        if status:
            break
    return Report(1, tuple(failures), said)


@cache
def _body(kind: int) -> bytes:
    """The file of a good soft body."""
    with tempfile.TemporaryDirectory() as folder:
        soft_body(kind).save(f"{folder}/body.npz")
        return Path(folder, "body.npz").read_bytes()


@cache
def _log() -> bytes:
    """A good log of 50 ms."""
    spec = _scene()
    model = spec.compile()
    model.opt.gravity[2] = -9.0 - 1 / 3  # a number that XML does not give
    with tempfile.TemporaryDirectory() as folder:
        record(model, 0.05, log=Log(f"{folder}/a.mcap"), scene=spec)
        return Path(folder, "a.mcap").read_bytes()


def damaged_body(rng: Rng, good: bytes) -> bytes:
    """Return the file of a soft body with a few arrays that are others, or of other bytes."""
    if rng.random() < 0.2:
        return other_bytes(rng, good)
    with np.load(io.BytesIO(good)) as file:
        arrays = {name: file[name] for name in file.files}
    return _packed(_few(rng, arrays, partial(other_array, rng)))


def damaged_log(rng: Rng, good: bytes) -> bytes:
    """Return a log with another message, fact or attachment, or of other bytes."""
    if rng.random() < 0.15:
        return other_bytes(rng, good)
    what = rng.choice(("message", "fact", "numbers", "scene", "file", "topic"))
    chosen, seen = int(rng.integers(20)), 0

    def change(one: Any) -> Any:
        nonlocal seen
        from mcap.records import Attachment, Channel, Message, Metadata

        if isinstance(one, Message) and what == "message":
            seen += 1
            if seen % 20 == chosen:
                one.data = other_message(rng, one.data)
        elif isinstance(one, Metadata) and what == "fact":
            key = str(rng.choice([*one.metadata, "world", "new"]))
            one.metadata = {**one.metadata, key: str(rng.choice(TOKENS))}
            if rng.random() < 0.3:
                del one.metadata[key]
            one.name = str(rng.choice((one.name, one.name, one.name, "world", "")))
        elif isinstance(one, Channel) and what == "topic" and rng.random() < 0.3:
            one.topic = str(
                rng.choice(("", "/", "/state", "/soft/", "/world_1/state", "state", f"/world_{'9' * 5000}/state"))
            )
            one.message_encoding = str(rng.choice(("json", one.message_encoding)))
        elif isinstance(one, Attachment):
            return _other_attachment(rng, what, one)
        return one

    return rewritten(good, change)


def rewritten(log: bytes, change: Callable[[Any], Any]) -> bytes:
    """Return a log with the channels, messages, metadata and attachments that `change` returns for its own."""
    from mcap.records import Attachment, Channel, Message, Metadata, Schema
    from mcap.stream_reader import StreamReader
    from mcap.writer import Writer

    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    numbers: dict[int, int] = {}
    schemas: dict[int, int] = {}
    for one in StreamReader(io.BytesIO(log)).records:
        if isinstance(one, Schema) and one.id not in schemas:
            schemas[one.id] = writer.register_schema(one.name, one.encoding, one.data)
        elif isinstance(one, Channel) and one.id not in numbers:
            changed = change(one)
            numbers[one.id] = writer.register_channel(changed.topic, changed.message_encoding, schemas[one.schema_id])
        elif isinstance(one, Message) and (changed := change(one)) is not None:
            writer.add_message(numbers[one.channel_id], changed.log_time, changed.data, changed.publish_time)
        elif isinstance(one, Metadata) and (changed := change(one)) is not None:
            writer.add_metadata(changed.name, changed.metadata)
        elif isinstance(one, Attachment) and (changed := change(one)) is not None:
            writer.add_attachment(0, 0, changed.name, changed.media_type, changed.data)
    writer.finish()
    return stream.getvalue()


def _other_attachment(rng: Rng, what: str, one: Any) -> Any:
    """An attachment of a log as it is, or another one, or None."""
    if what == "numbers" and one.name.startswith(NUMBERS):
        one.data = lzma.compress(_other_numbers(rng, lzma.decompress(one.data)))
    elif what == "scene" and not one.name.startswith(NUMBERS):
        one.data = lzma.compress(other_text(rng, lzma.decompress(one.data).decode()).encode())
    elif what == "file" and rng.random() < 0.5:
        one.name = str(rng.choice((one.name, NUMBERS, "../a.xz", "/tmp/a.xz", "")))
        one.data = (b"", other_bytes(rng, one.data), lzma.compress(bytes(10**7)), one.data)[rng.integers(4)]
        return None if rng.random() < 0.3 else one
    return one


def _other_numbers(rng: Rng, good: bytes) -> bytes:
    """The numbers of a packed scene, some of which are others, and any other arrays of a model."""
    model = _model()
    with np.load(io.BytesIO(good)) as file:
        arrays: Arrays = {name: file[name] for name in file.files}
    floats = dict(numbers_of(model))
    for name in rng.choice(list(floats), 3).tolist():
        arrays[name] = np.array(floats[name])
    fields = [name for name in dir(model) if isinstance(getattr(model, name), np.ndarray)]
    if rng.random() < 0.5:
        return _packed(
            arrays | {name: np.array(getattr(model, name)) * 0 + 10**8 for name in rng.choice(fields, 2).tolist()}
        )
    return _packed(_few(rng, arrays, partial(other_array, rng)))


def _scene() -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_string(SCENE)
    attach(spec, soft_body(0), "soft", pos=(0, 0, 0.1))
    return spec


@cache
def _model() -> mujoco.MjModel:
    return _scene().compile()


def _few(rng: Rng, arrays: Arrays, other: Callable[[NDArray[Any], Arrays], NDArray[Any] | None]) -> Arrays:
    """Arrays, one to three of which are others, or are left out."""
    changed: dict[str, NDArray[Any] | None] = dict(arrays)
    for name in rng.choice(list(arrays), rng.integers(1, 4)).tolist():
        changed[name] = other(arrays[name], arrays)
    return {name: array for name, array in changed.items() if array is not None}


def other_array(rng: Rng, array: NDArray[Any], others: Arrays) -> NDArray[Any] | None:
    """Return what may stand in an array's place; None for nothing."""
    with np.errstate(all="ignore"):
        return WAYS[rng.integers(len(WAYS))](rng, array, others)


def _cast(array: NDArray[Any], kind: str) -> NDArray[Any]:
    return array.astype(kind) if array.dtype.kind in "iuf" else array


def _one_extreme(rng: Rng, array: NDArray[Any], others: Arrays) -> NDArray[Any]:
    del others
    if array.dtype.kind not in "iuf" or not array.size:
        return np.array("x")
    value = EXTREME[rng.integers(len(EXTREME))]
    wide = array.astype(np.int64 if array.dtype.kind in "iu" and isinstance(value, int) else np.float64)
    wide.flat[rng.integers(wide.size)] = value
    return wide if array.dtype.kind == "f" or isinstance(value, int) else array


def _shuffled(rng: Rng, array: NDArray[Any], others: Arrays) -> NDArray[Any]:
    del others
    return rng.permutation(array.ravel()).reshape(array.shape)


def _scaled(rng: Rng, array: NDArray[Any], others: Arrays) -> NDArray[Any]:
    del others
    return array * array.dtype.type(rng.choice((0, 3, 100))) if array.dtype.kind in "iuf" else array


WAYS: tuple[Callable[[Rng, NDArray[Any], Arrays], NDArray[Any] | None], ...] = (
    lambda rng, array, others: None,
    lambda rng, array, others: np.array(EXTREME[rng.integers(len(EXTREME))]),
    lambda rng, array, others: array.ravel()[:-1],
    lambda rng, array, others: np.append(array, array.ravel()[-1:]),
    lambda rng, array, others: array[..., None],
    lambda rng, array, others: array.T[::-1] if array.ndim else array[None],
    lambda rng, array, others: array[:0] if array.ndim else array,
    lambda rng, array, others: np.zeros((2, 3)),
    lambda rng, array, others: np.array(TOKENS[rng.integers(len(TOKENS))]),
    lambda rng, array, others: np.zeros(2, [("a", "i4")]),
    lambda rng, array, others: _cast(array, str(rng.choice(("f2", "f8", "i8", "u1", "?", "c8")))),
    lambda rng, array, others: others[str(rng.choice(list(others)))],
    _one_extreme, _one_extreme, _one_extreme, _one_extreme,
    _shuffled, _shuffled,
    _scaled,
)  # fmt: skip


def other_message(rng: Rng, message: bytes) -> bytes:
    """Return a message of JSON with another value, or of other bytes."""
    way = rng.integers(6)
    if way == 0:
        return other_bytes(rng, message)
    if way == 1:
        return (b"[" * 10**5, b"{" * 9, b"", b"NaN", b"\xff\xfe", b'{"time": Infinity}', b'{"a":' * 10**4)[
            rng.integers(7)
        ]
    try:
        found = json.loads(message)
    except ValueError:
        return other_bytes(rng, message)
    key = str(rng.choice([*found, "new"]))
    if way == 2:
        found.pop(key, None)
    else:
        found[key] = TREES[rng.integers(len(TREES))]
    return json.dumps(found).encode()


def other_text(rng: Rng, text: str) -> str:
    """Return XML with another value of an attribute, without one, or cut off."""
    found = list(re.finditer(r'"([^"]*)"', text))
    for _ in range(rng.integers(1, 3)):
        one = found[rng.integers(len(found))]
        value = str(rng.choice((*TOKENS, one[1][:-1], one[1] + " 1", found[rng.integers(len(found))][1])))
        text = text[: one.start(1)] + value + text[one.end(1) :]
        found = list(re.finditer(r'"([^"]*)"', text))
    return text[: rng.integers(len(text))] if rng.random() < 0.1 else text


def other_bytes(rng: Rng, content: bytes) -> bytes:
    """Return bytes some of which are flipped, missing, zero or twice there."""
    if not content:
        return b"x"
    array = bytearray(content)
    first, second = sorted(rng.integers(len(array), size=2).tolist())
    way = rng.integers(5)
    if way == 0:
        for place in rng.integers(len(array), size=rng.integers(1, 20)).tolist():
            array[place] ^= 1 << int(rng.integers(8))
        return bytes(array)
    if way == 1:
        return bytes(array[:first])
    if way == 2:
        return bytes(array[:first] + array[second:])
    if way == 3:
        return bytes(array[:second] + array[first:])
    return bytes(array[:first] + bytes(second - first) + array[second:])


def _packed(arrays: Arrays) -> bytes:
    """An .npz."""
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)  # pyright: ignore[reportArgumentType]
    return stream.getvalue()


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
