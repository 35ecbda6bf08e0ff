"""Chains on disk: killed, resumed, damaged, and asked for by two at once."""

import signal

import numpy as np
import pytest

from ddetumble._errors import InputError
from ddetumble.posterior.chain import Settings, is_due, open_chain, read_arrays, run_chains, write_arrays
from ddetumble.posterior.ensemble import Ensembles
from ddetumble.posterior.nuts import Nuts
from docs.kill_study import compare, inspect, kill_once, make_target, start


SHORT = Settings(walkers=16, ensembles=2, burn=20, block=10, effective=10**9, most=60, seed=2)


def test_a_chain_that_stopped_goes_on_as_if_it_had_not(tmp_path):
    import dataclasses as dc

    target = make_target()
    whole = run_chains(Ensembles, target, SHORT, tmp_path / "whole")
    for most in (10, 20, 40):
        run_chains(Ensembles, target, dc.replace(SHORT, most=most), tmp_path / "parts")
    again = run_chains(Ensembles, target, SHORT, tmp_path / "parts")
    np.testing.assert_array_equal(again.x, whole.x)
    assert again.statistics["resumed"] == 60 and compare(tmp_path / "whole", tmp_path / "parts")
    # Nothing on disk at all gives the same numbers too.
    np.testing.assert_array_equal(run_chains(Ensembles, target, SHORT).x, whole.x)


@pytest.mark.slow
def test_nuts_goes_on_too(tmp_path):
    import dataclasses as dc

    target, settings = make_target(), dc.replace(SHORT, burn=30, most=40)
    whole = run_chains(Nuts, target, settings, tmp_path / "whole")
    run_chains(Nuts, target, dc.replace(settings, most=10), tmp_path / "parts")
    again = run_chains(Nuts, target, settings, tmp_path / "parts")
    np.testing.assert_array_equal(again.x, whole.x)
    assert again.statistics["resumed"] == 40


@pytest.mark.slow
def test_killed_at_random_moments(tmp_path):
    """The committed study does this a hundred times."""
    before = 0
    for wait in (0.05, 0.6, 1.7):
        row = kill_once(tmp_path / "chain", wait)
        assert row["unreadable"] == 0 and row["blocks"] >= max(before, row["told"])
        before = row["blocks"]


def test_a_write_that_was_cut_off_is_swept_away(tmp_path):
    target = make_target()
    run_chains(Ensembles, target, SHORT, tmp_path)
    (tmp_path / ".block-000009.npz.part").write_bytes(b"half a block")
    assert inspect(tmp_path)["parts"] == 1
    run_chains(Ensembles, target, SHORT, tmp_path)
    assert inspect(tmp_path) == {"blocks": 8, "unreadable": 0, "parts": 0}


def test_two_writers_are_one_too_many(tmp_path):
    with open_chain(tmp_path, {"a": 1}), pytest.raises(InputError, match="another process"):
        with open_chain(tmp_path, {"a": 1}):
            raise AssertionError
    with open_chain(tmp_path, {"a": 1}):  # free again
        pass


@pytest.mark.slow
def test_a_writer_in_another_process_is_seen(tmp_path):
    process = start(tmp_path)
    try:
        assert process.stdout is not None
        while process.stdout.readline().strip() not in ("1", "2"):
            assert process.poll() is None
        with pytest.raises(InputError, match="another process"):
            run_chains(Ensembles, make_target(), SHORT, tmp_path)
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()


def test_a_damaged_block_is_one_sentence(tmp_path):
    target = make_target()
    run_chains(Ensembles, target, SHORT, tmp_path)
    file = tmp_path / "block-000003.npz"
    whole = file.read_bytes()
    for damaged in (whole[:200], b"", b"x" * 300, whole[:-40]):
        file.write_bytes(damaged)
        with pytest.raises(InputError, match="damaged"):
            run_chains(Ensembles, target, SHORT, tmp_path)
    for later in tmp_path.glob("block-*.npz"):
        if later.name >= file.name:
            later.unlink()
    again = run_chains(Ensembles, target, SHORT, tmp_path)  # what the sentence tells one to do
    assert again.statistics["resumed"] == 30 and again.x.shape[1] == 60


def test_a_chain_of_something_else_is_refused(tmp_path):
    import dataclasses as dc

    target = make_target()
    run_chains(Ensembles, target, SHORT, tmp_path)
    with pytest.raises(InputError, match="walkers is 16 there and 20 now"):
        run_chains(Ensembles, target, dc.replace(SHORT, walkers=20), tmp_path)
    (tmp_path / "chain.json").write_text("{}")
    with pytest.raises(InputError, match="not a description of a chain"):
        run_chains(Ensembles, target, SHORT, tmp_path)
    (tmp_path / "chain.json").unlink()
    with pytest.raises(InputError, match="without its plan"):
        run_chains(Ensembles, target, SHORT, tmp_path)


def test_arrays_come_back_and_nothing_is_run(tmp_path):
    file = tmp_path / "a.npz"
    write_arrays(file, {"x": np.arange(3.0), "n": np.array(2)})
    assert read_arrays(file)["x"].tolist() == [0.0, 1.0, 2.0]
    np.savez(file, x=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match="damaged"):
        read_arrays(file)


def test_chains_are_judged_at_the_same_steps_however_often_they_stop():
    due = [n for n in range(0, 4000) if is_due(20 + 10 * n, Settings(burn=20, block=10, most=10**6))]
    assert due[:9] == [0, 1, 2, 3, 4, 5, 6, 7, 8] and len(due) < 60
    assert np.all(np.diff(due) <= np.maximum(1, np.array(due[:-1]) // 3))
