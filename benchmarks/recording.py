"""Measure how fast a run is logged: messages to MCAP, samples and rows of columns to a Rerun recording.

Usage: python benchmarks/recording.py

A tumbling body, without thinning. "Writer" begins with the node's messages before they are packed, and compares our
writer with that of the package mcap, with equal chunk sizes, compressed and not. "Mcap" and "sink" are the whole path
from events, one by one as in the node, to the closed file; offline they come in blocks, which `whole_runs.py` measures.
"Columns" begins with a batch in arrays; a row is one time of one entity. "Scalars" is
a single entity in one call, which is the cost of Rerun itself. Best of several repeats, in processor time unless
stated otherwise, on this machine.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
from mcap.writer import CompressionType, Writer

import rb_dynamics as rb
from rb_dynamics.formats.channel_metadata import log_channel
from rb_dynamics.formats.mcap_writer import CHUNK_BYTES, McapWriter
from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.logs.messages import SAMPLE_TOPICS, sample_encoder
from rb_dynamics.run.event_arrays import stacked
from rb_dynamics.run.sink import RunInfo, Sample, Sink
from rb_dynamics.scene.shipped import shipped
from rb_dynamics.sinks import rerun_style as style
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.sinks.rerun_columns import gather
from rb_dynamics.sinks.rerun_sink import BATCH_ROWS, Recorder, RerunSink
from rb_dynamics.sinks.rerun_thinning import KeptRows

SAMPLES = 20 * BATCH_ROWS
WRITTEN = 10_000
REPEATS = 5


def main() -> None:
    scene = rb.read_scene(shipped("config/dzhanibekov.yaml"), {"output_rate": SAMPLES / 100.0})
    memory = rb.MemorySink()
    rb.simulate(scene, sinks=[memory])
    samples = memory.samples
    with tempfile.TemporaryDirectory() as folder:
        log, path = Path(folder) / "run.mcap", Path(folder) / "run.rrd"
        writers(log, scene, samples)
        rate = len(samples) / best(lambda: through(McapSink(log), scene, samples))
        print(f"mcap      {rate * len(SAMPLE_TOPICS):12,.0f} messages/s, {rate:,.0f} samples/s")
        print(f"          {log.stat().st_size / len(samples):12.0f} bytes per sample")
        rate = len(samples) / best(lambda: through(RerunSink(path, max_rows=10**9), scene, samples))
        print(f"sink      {rate:12,.0f} samples/s")
        print(f"          {path.stat().st_size / len(samples):12.0f} bytes per sample")
        print(f"columns   {columns(path, scene, samples):12,.0f} rows/s in batches of {BATCH_ROWS}")
        print(f"scalars   {scalars(path):12,.0f} rows/s of 3 numbers")


def writers(path: Path, scene: rb.Scene, samples: list[Sample]) -> None:
    """Print the messages per second through each writer."""
    encode = sample_encoder(scene)
    packed = [(sample.time_ns, encode(sample)) for sample in samples[:WRITTEN]]
    size = sum(map(len, packed[0][1]))
    print(f"writer    {size:12,.0f} bytes in the {len(SAMPLE_TOPICS)} messages of a sample")
    for compression in (CompressionType.ZSTD, CompressionType.NONE):
        for name, task in (("ours", ours), ("mcap", library)):
            rate = len(packed) * len(SAMPLE_TOPICS) / best(partial(task, path, compression, packed))
            print(f"          {rate:12,.0f} messages/s, {name}, {compression.name.lower()}")


Packed = list[tuple[int, tuple[bytes, ...]]]


def ours(path: Path, compression: CompressionType, packed: Packed) -> float:
    file = OutputFile(path)
    with patch.dict(sys.modules, {} if compression == CompressionType.ZSTD else {"zstandard": None}):
        writer = McapWriter(file, "benchmark")
    begin = time.process_time()
    writer.begin()
    ids = [writer.add_channel(log_channel(topic, kind, "")) for topic, kind in SAMPLE_TOPICS]
    for time_ns, messages in packed:
        writer.add_messages(ids, messages, time_ns, time_ns)
    writer.finish()
    file.close()
    return time.process_time() - begin


def library(path: Path, compression: CompressionType, packed: Packed) -> float:
    with path.open("wb") as file:
        writer = Writer(file, CHUNK_BYTES, compression)
        begin = time.process_time()
        writer.start("ros2", "benchmark")
        ids = [
            writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", b""))
            for topic, kind in SAMPLE_TOPICS
        ]
        for time_ns, messages in packed:
            for channel, message in zip(ids, messages, strict=True):
                writer.add_message(channel, time_ns, message, time_ns)
        writer.finish()
        return time.process_time() - begin


def best(task: Callable[[], float]) -> float:
    return min(task() for _ in range(REPEATS))


def through(sink: Sink, scene: rb.Scene, samples: list[Sample]) -> float:
    sink.open(RunInfo(scene, "exact"))
    begin = time.perf_counter()
    for sample in samples:
        sink.write(sample)
    sink.close({})
    return time.perf_counter() - begin


def columns(path: Path, scene: rb.Scene, samples: list[Sample]) -> float:
    """Return rows per second through what the sink does with each batch."""
    series = style.series_of(scene)
    batches = []
    for first in range(0, len(samples), BATCH_ROWS):
        part = samples[first : first + BATCH_ROWS]
        kept = KeptRows(range(first, first + len(part)), stacked(part), [HeldWrench()] * len(part))
        batches.append(gather([kept], series))
    # Poses and plane; arrows at the body, of which force and torque have none here; arrows of Poinsot's construction.
    moving = 4 + 2 + 2

    def task() -> float:
        recorder = Recorder(path, RunInfo(scene, "exact"), 10**9, BATCH_ROWS)
        recorder.begin()
        begin = time.perf_counter()
        for batch in batches:
            recorder.send_columns(batch)
        recorder.stream.flush()
        spent = time.perf_counter() - begin
        recorder.stream.disconnect()
        return spent

    return len(samples) * (len(series) + moving) / best(task)


def scalars(path: Path) -> float:
    """Return rows per second of one entity in one call."""
    import rerun as rr

    count = 50 * SAMPLES
    times = np.arange(count).astype("timedelta64[us]")
    values = np.random.default_rng(1).random((count, 3))

    def task() -> float:
        stream = rr.RecordingStream("benchmark")
        stream.save(path)
        begin = time.perf_counter()
        column = rr.Scalars.columns(scalars=values.ravel()).partition(np.full(count, 3))
        stream.send_columns("a", [rr.TimeColumn("sim_time", duration=times)], column)
        stream.flush()
        return time.perf_counter() - begin

    return count / best(task)


if __name__ == "__main__":
    main()
