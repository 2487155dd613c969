"""Data sets are the same rows where a machine of a Ray cluster is killed while it works."""

import os
import subprocess
import sys

import pytest

from xdex_drake.cli import main
from xdex_drake.dataset.folder import completed_units, failed_units

pytest.importorskip("ray", reason="needs Ray, of the extra `ray`")

RUN = """
import sys, time
from ray.cluster_utils import Cluster
from xdex_drake.dataset.folder import Manifest, open_dataset
from xdex_drake.dataset.grasp_file import read_grasps
from xdex_drake.jobs import pairs
from xdex_drake.jobs.pairs import DatasetConfig, UnitRows, generate

CONFIG = DatasetConfig(hands=("inspire", "ability"), objects=("can", "box", "ball", "mug", "bottle", "bowl"))
folder = sys.argv[1]

def work(unit, config):
    # A unit that takes its time; its rows are those of the plan, and here none: its bytes are what is compared.
    time.sleep(0.4)
    return UnitRows((), (pairs.Rejected(unit.source, unit.name, f"seed {unit.seed}"),))

if __name__ == "__main__":
    pairs.run_unit = work
    generate(CONFIG, folder + "/one", workers=0)
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    other, done = cluster.add_node(num_cpus=2), []

    def save(result):
        done.append(result)
        if len(done) == 2:
            cluster.remove_node(other, allow_graceful=False)

    print(generate(CONFIG, folder + "/ray", ray=cluster.address, on_done=save))
    cluster.shutdown()
"""


def test_a_machine_that_is_killed_costs_no_row(tmp_path):
    (tmp_path / "run.py").write_text(RUN)
    # Ray's workers yield to everything else by default; and what is tried here is not how long it takes.
    environment = os.environ | {"RAY_worker_niceness": "0"}
    words = [sys.executable, "run.py", str(tmp_path)]
    run = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=280)
    assert run.stdout.strip().endswith("(12, 0)"), run.stderr[-2000:]
    shards = [
        {path.name: path.read_bytes() for path in sorted((tmp_path / name / "shards").iterdir())}
        for name in ("one", "ray")
    ]
    assert shards[0] == shards[1] and len(completed_units(tmp_path / "ray")) == 12
    assert not failed_units(tmp_path / "ray")


def test_an_address_where_nothing_answers_is_told(tmp_path, capsys):
    config = tmp_path / "c.yaml"
    config.write_text("hands: [inspire, ability]\nobjects: [can]\n")
    words = ["dataset", "generate", str(config), "--out", str(tmp_path / "o"), "--ray", "127.0.0.1:1"]
    assert main(words) == 2
    assert "--ray 127.0.0.1:1: no Ray cluster answers" in capsys.readouterr().err
