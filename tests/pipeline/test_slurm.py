"""What docs/guide/clusters.md tells users of Slurm, tried where no Slurm is: the scripts that would be submitted, and their commands."""

import os
import re
import subprocess
from pathlib import Path

import pytest

import toile
from toile.console import shard_of

PAGE = (Path(__file__).parents[2] / "docs" / "guide" / "clusters.md").read_text()


def listing(kind, word):
    """The page's listing of a kind in which a word stands."""
    (found,) = (text for text in re.findall(rf"```{kind}\n(.*?)```", PAGE, re.S) if word in text)
    return found


def test_the_example_asks_slurm_for_workers_of_one_thread(monkeypatch):
    slurm = pytest.importorskip("dask_jobqueue").SLURMCluster
    scripts, asked = [], []
    monkeypatch.setattr(slurm, "scale", lambda cluster, jobs: scripts.append((jobs, cluster.job_script())))

    def register(capture, run, scheduler):
        asked.append((capture, run, scheduler))
        return toile.Outcome((1,), {})

    monkeypatch.setattr(toile, "register", register)
    exec(listing("python", "SLURMCluster"), {"__name__": "__main__"})
    jobs, script = scripts[0]  # it is scaled to nothing at the end
    assert jobs == 6 and asked[0][:2] == ("/data/capture", "/data/run") and asked[0][2].startswith("tcp://")
    for line in ("-p cpu", "-n 1", "--cpus-per-task=16", "--mem=60G", "-t 08:00:00"):
        assert f"#SBATCH {line}\n" in script
    command = script.splitlines()[-1]
    assert all(f"{words} " in command for words in (asked[0][2], "--nworkers 16", "--nthreads 1"))
    assert command.rindex("--memory-limit 0") > command.index("--memory-limit")  # the last one counts


@pytest.fixture
def shell(tmp_path):
    """Runs a script where `toile` and `sbatch` are programs that say what they were given; its lines."""
    for name, answer in (("toile", ""), ("sbatch", "echo '17;east'\n")):
        program = tmp_path / name
        program.write_text(f'#!/bin/sh\necho {name} "$@" >> {tmp_path}/said\n{answer}')
        program.chmod(0o755)

    def run(script, **variables):
        there = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"} | variables
        subprocess.run(["sh", "-eu", "-c", script], env=there, check=True)
        return (tmp_path / "said").read_text().splitlines()

    return run


def test_an_array_job_gives_each_task_its_shard(shell):
    (said,) = shell(listing("sh", "#SBATCH --array"), SLURM_ARRAY_TASK_ID="7")
    assert said == "toile register /data/capture /data/run --shard 7/20 --workers 16"
    assert shard_of(said.split()[5]) == (7, 20)


def test_the_last_shard_waits_for_the_others(shell):
    array, last = shell(listing("sh", "--dependency"))
    assert array == "sbatch --parsable --array=1-19 shard.sh"
    assert last == "sbatch --dependency=afterany:17 --cpus-per-task=128 last.sh"
