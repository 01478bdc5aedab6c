"""How many gradient steps a second: ours, burn's and Stable-Baselines3's, in one run.

    learning_speed.py PYTHON [--rounds N] [--steps N] [--write docs/training.md]

PYTHON is an interpreter with torch, stable-baselines3 and onnxruntime (`pip install torch
stable-baselines3 onnxruntime`; PyPI's torch brings 3 GB of CUDA libraries that nothing here uses).
burn is built first, 20 CPU-minutes the first time. Not part of the default CI for these two.

The three take turns, one thread each; medians and ratios are printed and, with --write, put
between the marks of the document, as is the time of a decision by tract and onnxruntime. Fails
below twice burn's rate, below five times Stable-Baselines3's, and below 150,000 slots a second.
"""

import argparse
import os
import pathlib
import re
import statistics
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
BENCH = ["cargo", "bench", "--quiet", "--locked", "-p", "trainer"]
BURN = ["cargo", "build", "--release", "--locked", "--manifest-path",
        "trainer/compare/burn/Cargo.toml", "--target-dir", "target/burn"]
ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}


def output(command):
    return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True,
                          env=os.environ | ONE_THREAD).stdout


def number(command):
    """The number at the end of what a program prints."""
    return float(output(command).split()[-1])


def write_table(path, name, table):
    text = path.read_text()
    opening, closing = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, rest = text.split(opening)
    after = rest.split(closing)[1]
    path.write_text(f"{before}{opening}\n{table}{closing}{after}")


def steps_table(python, rounds, steps):
    contenders = {
        "ours": BENCH + ["--bench", "learning", "--", "sac"],
        "burn": ["target/burn/release/burn-steps"],
        "stable-baselines3": [python, ".ci/interop/sb3_steps.py"],
    }
    subprocess.run(BURN, cwd=ROOT, check=True)
    rates = {name: [] for name in contenders}
    for turn in range(rounds):
        for name, command in contenders.items():
            rates[name].append(number(command + [str(steps)]))
        print(f"turn {turn + 1}: " + ", ".join(f"{n} {r[-1]:.0f}/s" for n, r in rates.items()))
    medians = {name: statistics.median(values) for name, values in rates.items()}
    table = (f"| gradient step of SAC, one thread | steps/s, median of {rounds} turns | least to most "
             "| ours is faster by |\n|---|---|---|---|\n")
    for name, median in medians.items():
        spread = f"{min(rates[name]):.0f} to {max(rates[name]):.0f}"
        table += f"| {name} | {median:.0f} | {spread} | {medians['ours'] / median:.1f} |\n"
    missed = [f"only {medians['ours'] / medians[name]:.2f} times {name}, not {least}"
              for name, least in (("burn", 2), ("stable-baselines3", 5))
              if medians["ours"] < least * medians[name]]
    slots = statistics.median(number(BENCH + ["--bench", "learning", "--", "environment"])
                              for _ in range(rounds))
    table += f"| environment, slots/s | {slots:.0f} | | |\n"
    if slots < 150_000:
        missed.append(f"only {slots:.0f} slots/s, not 150000")
    return table, missed


def plan_table(python):
    policy = "models/separated-sac.onnx"
    lines = (output(BENCH + ["--features", "onnx", "--bench", "plan"])
             + output([python, ".ci/interop/policy_latency.py", policy]))
    pattern = r"^(\w+) of 100,000: median ([\d.]+) us, 99.9 % ([\d.]+) us, worst ([\d.]+) us$"
    found = re.findall(pattern, lines, re.MULTILINE)
    assert [name for name, *_ in found] == ["tract", "onnxruntime"], lines
    table = f"| a decision of {policy} | median, us | 99.9 %, us | worst of 100,000, us |\n|---|---|---|---|\n"
    return table + "".join(f"| {' | '.join(row)} |\n" for row in found)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("python")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=1_000)
    parser.add_argument("--write", type=pathlib.Path)
    arguments = parser.parse_args()
    steps, missed = steps_table(arguments.python, arguments.rounds, arguments.steps)
    plan = plan_table(arguments.python)
    print(steps + "\n" + plan)
    if arguments.write:
        write_table(arguments.write, "learning speed", steps)
        write_table(arguments.write, "plan", plan)
    if missed:
        sys.exit("\n".join(missed))


if __name__ == "__main__":
    main()
