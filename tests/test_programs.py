"""Programs kept between processes: found without tracing, told apart, and traced anew where they cannot be read."""

import functools
import os
import subprocess
import sys
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ddetumble as dd
from ddetumble.inference import programs
from ddetumble.inference.parameters import Common, ParameterSpace


X, Y = jnp.arange(3.0), {"a": jnp.ones(3)}


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """A cache folder of its own, in a process that knows no program yet."""
    monkeypatch.setattr(programs, "_known", {})
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path
    jax.config.update("jax_compilation_cache_dir", before)


def make_function(traced):
    """A jitted function that says when it is traced."""
    def f(factor, x, y):
        traced.append(factor)
        return {"sum": factor * (x + y["a"]), "count": jnp.asarray(x.size)}

    return jax.jit(f, static_argnums=0)


def call(function, factor=2.0, name="two", x=X):
    """The function by its kept program."""
    return programs.call_kept(function, (factor,), name, {"sum": 0, "count": 0}, x, Y)


def list_programs(folder):
    """Names of what is kept."""
    return sorted(path.name for path in folder.glob("*-program"))


def test_the_next_process_traces_nothing(folder, monkeypatch):
    """The value is that of the function, in this process and, from the file alone, in the next."""
    traced, function = [], None
    function = make_function(traced)
    first = call(function)
    np.testing.assert_array_equal(first["sum"], 2.0 * (X + 1.0))
    assert first["count"] == 3 and len(list_programs(folder)) == 1
    call(function)
    monkeypatch.setattr(programs, "_known", {})
    jax.clear_caches()
    traced.clear()
    np.testing.assert_array_equal(call(function)["sum"], first["sum"])
    assert not traced


def test_what_differs_is_another_program(folder):
    """By name, shape and code."""
    function = make_function([])
    call(function)
    np.testing.assert_array_equal(call(function, 3.0, "three")["sum"], 3.0 * (X + 1.0))
    call(function, x=jnp.arange(1.0))
    assert len(list_programs(folder)) == 3


def test_damaged_program_is_traced_anew(folder, monkeypatch):
    """Half a file is no error, and is written again."""
    function = make_function([])
    expected = call(function)["sum"]
    (path,) = folder.glob("*-program")
    whole = path.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], b"no program"):
        path.write_bytes(damaged)
        monkeypatch.setattr(programs, "_known", {})
        np.testing.assert_array_equal(call(function)["sum"], expected)
        assert len(path.read_bytes()) > len(damaged)


def test_nothing_is_kept_without_a_name_or_of_what_calls_back(folder):
    """A program of a user's class, or one that calls Python while it runs, works and leaves no file."""
    call(make_function([]), name=None)

    @jax.jit
    def calls_back(x, y):
        return jax.pure_callback(lambda a: np.asarray(a), jax.ShapeDtypeStruct(x.shape, x.dtype), x) + y["a"]

    np.testing.assert_array_equal(programs.call_kept(calls_back, (), "calls back", 0, X, Y), X + 1.0)
    assert not list_programs(folder)


def make_kept(traced):
    """The same by `keep_program`: words and structure of its arguments are part of the program, arrays are traced."""
    @programs.keep_program((0, 0))
    def f(way, model, x):
        traced.append(way)
        return (model["a"] + x if way == "sum" else model["a"] * x), model["none"] is None

    return f


def test_a_kept_function_is_traced_once_for_all_processes(folder, monkeypatch):
    """Told apart by what is no array among its arguments; ordinary inside another transformation."""
    traced = []
    f, model = make_kept(traced), {"a": np.full(3, 2.0), "none": None}
    np.testing.assert_array_equal(f("sum", model, X)[0], X + 2.0)
    np.testing.assert_array_equal(f("product", model, X)[0], 2.0 * X)
    assert f("sum", model, X)[1] and len(list_programs(folder)) == 2
    monkeypatch.setattr(programs, "_known", {})
    jax.clear_caches()
    traced.clear()
    np.testing.assert_array_equal(f("sum", model, X)[0], X + 2.0)
    assert not traced
    np.testing.assert_array_equal(jax.vmap(lambda x: f("product", model, x)[0])(jnp.ones((4, 3))), np.full((4, 3), 2.0))
    assert jax.grad(lambda x: jnp.sum(f("product", model, x)[0]))(X).tolist() == [2.0, 2.0, 2.0]


def test_a_kept_function_of_what_only_this_process_knows_leaves_nothing(folder):
    """A class of the user's has a name that says nothing of its code, and a function none at all."""
    class Own(eqx.Module):
        a: jax.Array

    @dataclass(frozen=True)
    class Weighted:  # its repr holds no address, and nothing of its code
        weight: float

        def __call__(self, x):
            return self.weight * x

    @programs.keep_program(0)
    def f(model, x):
        return (model.a if isinstance(model, Own) else model(1.0)) * x

    np.testing.assert_array_equal(f(Own(jnp.ones(3)), X), X)
    for own in (lambda a: 3.0 * a, Weighted(3.0), Weighted(3.0).__call__, functools.partial(Weighted(3.0))):
        np.testing.assert_array_equal(f(own, X), 3.0 * X)
        assert programs.name_structure({"goal": (own,)}) is None
    assert not list_programs(folder)
    ours = dd.Ball().extend([dd.effects.Adhesion()])
    assert programs.name_structure(ours) == programs.name_structure(dd.Ball(1.5).extend([dd.effects.Adhesion(2.0)]))
    assert programs.name_structure(ours) != programs.name_structure(dd.Ball().extend([dd.effects.GasLeak()]))
    assert programs.name_structure(ours) is not None and programs.name_structure((ours, Own)) is None


def test_a_space_has_a_text_where_all_is_the_packages_own():
    """Equal texts of equal spaces; none with an effect or a choice that another process does not know."""
    class Own(dd.effects.Adhesion):
        id = "own"

    spaces = [ParameterSpace(dd.Ball(**choice), effects) for choice in ({}, {"truncated": True})
              for effects in (dd.effects.IMPACT, dd.effects.IMPACT[:3])]
    assert len({space.text for space in spaces}) == 4 and None not in {space.text for space in spaces}
    assert spaces[0].text == ParameterSpace(dd.Ball(1.5), dd.effects.IMPACT).text
    assert ParameterSpace(dd.Ball(), (Own,)).text is None
    shared = [ParameterSpace(dd.Ball(), (), [Common("approach_speed", 0.01, way, "m/s")]) for way in (True, False)]
    assert shared[0] != shared[1] and shared[0].text != shared[1].text


def test_the_chosen_device_decides(folder, monkeypatch):
    """Where a GPU is JAX's first device, a program made for the processor is called within its `default_device`."""
    monkeypatch.setattr(programs.export, "default_export_platform", lambda: "cuda")
    function = make_function([])
    with jax.default_device(jax.devices("cpu")[0]):
        np.testing.assert_array_equal(call(function)["sum"], 2.0 * (X + 1.0))
    assert len(list_programs(folder)) == 1


@pytest.mark.slow
def test_a_filled_cache_leaves_nothing_to_compile(tmp_path):
    """A search in a new process finds all programs, the small ones too, where another of its size left them."""
    code = ("import sys, jax\n"
            "missed = []\n"
            "jax.monitoring.register_event_listener(lambda name, **_: missed.append(name))\n"
            "from ddetumble.cli import main\n"
            "assert main(sys.argv[1:]) == 0\n"
            "print('misses', sum(name.endswith('/cache_misses') for name in missed))")
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "cache")}
    counts = []
    for words in (["cache", "fill", "slip-a"], ["discover", "slip-c", "-o", tmp_path / "found"]):
        done = subprocess.run([sys.executable, "-c", code, *words], env=environment, capture_output=True,
                              text=True)
        assert done.returncode == 0, done.stderr
        counts.append(int(done.stdout.split("misses ")[1].split()[0]))
    assert counts[0] > 0 and counts[1] == 0
