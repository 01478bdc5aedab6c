"""The reader of the Python package mcap reads a flight's log, and its slots are those of slots.csv.

usage: mcap_log.py RUN_FOLDER LOG.mcap

The users of the mission must not move.
"""

import collections
import csv
import json
import math
import pathlib
import sys

import jsonschema
from mcap.reader import make_reader

SCHEMAS = {
    "/vehicle/location": "foxglove.LocationFix",
    "/vehicle/pose": "foxglove.PoseInFrame",
    "/vehicle/path": "foxglove.PosesInFrame",
    "/scene": "foxglove.SceneUpdate",
    "/slots": "aircomp_uav.Slot",
    "/events": "foxglove.Log",
}
WORDS = ("limited_by", "shield", "channel_source")

folder, log = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
summary = json.loads((folder / "summary.json").read_text())
with (folder / "slots.csv").open(newline="") as file:
    rows = list(csv.DictReader(file))

# Every message is valid under the schema that the file has for it, and times do not go back.
messages = collections.defaultdict(list)
validators, last = {}, 0
with log.open("rb") as file:
    reader = make_reader(file, validate_crcs=True)
    for schema, channel, message in reader.iter_messages():
        assert (schema.name, schema.encoding) == (SCHEMAS[channel.topic], "jsonschema"), channel
        assert channel.message_encoding == "json", channel
        assert message.log_time >= last, f"time goes back at {message.log_time}"
        last = message.log_time
        if channel.topic not in validators:
            text = json.loads(schema.data)
            jsonschema.Draft202012Validator.check_schema(text)
            validators[channel.topic] = jsonschema.Draft202012Validator(text)
        content = json.loads(message.data)
        validators[channel.topic].validate(content)
        if "timestamp" in content:
            stamp = content["timestamp"]
            assert stamp["sec"] * 10**9 + stamp["nsec"] == message.log_time, channel.topic
        messages[channel.topic].append((message.log_time, content))
    statistics = reader.get_summary().statistics
    [metadata] = [record.metadata for record in reader.iter_metadata()]
assert set(messages) == set(SCHEMAS), set(messages)
assert statistics.message_count == sum(len(found) for found in messages.values())
assert metadata["scenario"] == summary["scenario"] and metadata["policy"] == summary["policy"]

# The slots, column by column.
slots = [content for _, content in messages["/slots"]]
assert len(slots) == len(rows) == summary["slots"], (len(slots), len(rows))
for slot, row in zip(slots, rows):
    assert set(slot) == set(row), set(slot) ^ set(row)
    for name, text in row.items():
        value = slot[name]
        if value is None:
            assert text == "" or not math.isfinite(float(text)), (name, text)
        elif isinstance(value, bool):
            assert text == str(value).lower(), (name, text)
        elif name in WORDS:
            assert text == value, (name, text)
        else:
            assert float(text) == value, (name, text)
assert math.isclose(sum(slot["rate_bit_s_hz"] for slot in slots), summary["sum_rate"], rel_tol=1e-12)

# Where the vehicle was when a slot ended, and whom it served.
poses = [(time, content["pose"]["position"]) for time, content in messages["/vehicle/pose"]]
services = [content["entities"][0] for _, content in messages["/scene"][1:]]
users = messages["/scene"][0][1]["entities"][2]["spheres"]
assert len(messages["/vehicle/location"]) == len(poses)
furthest = 0.0
for (time, slot), service in zip(messages["/slots"], services):
    _, place = min(poses, key=lambda pose: abs(pose[0] - time))
    away = math.hypot(place["x"] - slot["flown_east_m"], place["y"] - slot["flown_north_m"])
    furthest = max(furthest, away)
    [line] = service["lines"]
    assert line["points"][0]["x"] == slot["flown_east_m"], slot["slot"]
    user = users[slot["served_user"]]["pose"]["position"]
    assert (line["points"][1]["x"], line["points"][1]["y"]) == (user["x"], user["y"]), slot["slot"]
# A pose is at most 0.1 s away from the end of its slot, in which a vehicle flies 3 m at 30 m/s, and
# the ground receives a slot some steps of 10 ms later.
assert furthest <= 6.0, f"{furthest} m from a slot's position"
# The path after the last slot has all poses so far.
time, path = messages["/vehicle/path"][-1]
assert len(path["poses"]) == sum(pose_time <= time for pose_time, _ in poses)
assert len(path["poses"]) >= len(rows)
counts = ", ".join(f"{topic} {len(found)}" for topic, found in sorted(messages.items()))
print(f"{log.name}: {log.stat().st_size / 1e6:.1f} MB, {counts}; positions within {furthest:.3f} m")
