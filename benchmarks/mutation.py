"""Mutation testing of what decides a verdict: small changes of the code, and how many of them the unit tests notice.

    python -m benchmarks.mutation -o fits/mutation

A mutant changes one operator, constant or returned value of one function; its code takes the place of the function's in
this process, the module's own tests that run this function run until the first fails, and the code is put back.
Messages, documentation, defaults of arguments and what raises an error are left alone. Of each module a fixed sample is
drawn. What was found of other modules before stays in the folder, and the page says of which state of the code it is.
"""

import argparse
import ast
import contextlib
import copy
import hashlib
import importlib
import io
import json
import os
import random
import signal
import sys
import time
from pathlib import Path
from types import CodeType

import pytest


# Of matrices as small as those of tests; threads of it would wait for each other on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parent.parent
VALUES = "tests/test_impact_values.py"
SELECTION = ("tests/test_selection.py", "tests/test_search.py", "tests/test_statistics.py", VALUES)
# What decides, and the tests that have to notice.
MODULES = {
    "selection.lack_of_fit": SELECTION,
    "selection.cross_validation": SELECTION,
    "selection.forward_selection": SELECTION,
    "inference.goodness": ("tests/test_statistics.py",),
    "inference.identifiability": ("tests/test_identifiability.py", VALUES),
    "inference.noise": ("tests/test_noise.py", VALUES),
    "inference.noise_estimation": ("tests/test_noise.py", "tests/test_faults.py"),
    "inference.bounded": ("tests/test_intervals.py", "tests/test_bounded.py"),
    "selection.leave_record_out": ("tests/test_outliers.py",),
    "selection.outliers": ("tests/test_outliers.py",),
    "selection.data_errors": ("tests/test_data_errors.py", "tests/test_baseline.py"),
}
PROSE = ("tell_", "say_", "_say", "_tell", "_format", "__str__", "__repr__", "describe", "mention")
SWAPS: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
LONGEST = 180  # s, after which a mutant that never ends counts as noticed


class Sites(ast.NodeVisitor):
    """Every place of a module that can be changed: (function, path of the node, kind)."""

    def __init__(self):
        self.found: list[tuple[str, ast.AST, str]] = []
        self.names: list[str] = []

    def _enter(self, node):
        if any(node.name.startswith(word) for word in PROSE):
            return
        self.names.append(node.name)
        for part in node.body:
            self.visit(part)
        self.names.pop()

    visit_FunctionDef = visit_ClassDef = _enter

    def visit_JoinedStr(self, node):
        """Messages are left alone."""

    def visit_Raise(self, node):
        """What is wrong with the input is tested elsewhere."""

    def visit_keyword(self, node):
        """So is `strict`, which does nothing but raise one."""
        if node.arg != "strict":
            self.generic_visit(node)

    def visit_Call(self, node):
        """`reshape` takes any negative number for what is left."""
        if not (isinstance(node.func, ast.Attribute) and node.func.attr == "reshape"):
            return self.generic_visit(node)
        for part in (node.func, *node.args):
            if ast.unparse(part) != "-1":
                self.visit(part)

    def visit_AnnAssign(self, node):
        """Fields of records and their types."""
        if node.value is not None and len(self.names) and not self.names[-1][:1].isupper():
            self.visit(node.value)

    def generic_visit(self, node):
        if self.names and not self.names[-1][:1].isupper():
            where = ".".join(self.names)
            if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in SWAPS:
                self.found.append((where, node, "operator"))
            elif isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPS:
                self.found.append((where, node, "comparison"))
            elif isinstance(node, ast.Constant) and type(node.value) in (int, float, bool):
                self.found.append((where, node, "constant"))
            elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
                self.found.append((where, node, "sign"))
            elif isinstance(node, ast.Return) and node.value is not None and ast.unparse(node.value) != "None":
                self.found.append((where, node, "return"))
        super().generic_visit(node)


def mutate(tree: ast.Module, number: int) -> tuple[str, int, str, str]:
    """Change the site of this number in place; returns function, line, and source before and after."""
    sites = Sites()
    sites.visit(tree)
    where, node, kind = sites.found[number]
    before = ast.unparse(node)
    if kind == "operator":
        node.op = SWAPS[type(node.op)]()
    elif kind == "comparison":
        node.ops[0] = SWAPS[type(node.ops[0])]()
    elif kind == "constant":
        node.value = (not node.value) if isinstance(node.value, bool) else node.value + 1
    elif kind == "sign":
        node.op = ast.UAdd() if isinstance(node.op, ast.USub) else ast.Not()
        if isinstance(node.op, ast.Not):
            node.operand = ast.UnaryOp(ast.Not(), node.operand)
    else:
        node.value = ast.Constant(None)
    ast.fix_missing_locations(tree)
    return where, node.lineno, before, ast.unparse(node)


def find_code(code: CodeType, names: list[str]) -> CodeType:
    """The code object of a function by its names from the module on."""
    for name in names:
        code = next(one for one in code.co_consts if isinstance(one, CodeType) and one.co_name == name)
    return code


class Reach:
    """A plugin of pytest that notes which of a module's functions each test runs, and how long it takes."""

    def __init__(self, codes):
        self.took: dict[str, float] = {}
        self.always: dict[Path, set] = {}  # what fixtures and imports ran, by file: any test of it may need that
        self.own: dict[str, set] = {}
        self.now: set[CodeType] = set()
        monitoring, tool = sys.monitoring, sys.monitoring.PROFILER_ID
        monitoring.use_tool_id(tool, "mutation")
        monitoring.register_callback(tool, monitoring.events.PY_START, lambda code, offset: self.now.add(code))
        for code in codes:
            monitoring.set_local_events(tool, code, monitoring.events.PY_START)

    def close(self):
        """Note no more."""
        sys.monitoring.free_tool_id(sys.monitoring.PROFILER_ID)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item):
        """What ran up to here came from fixtures or imports."""
        result = yield
        self.always.setdefault(item.path, set()).update(self.now)
        self.now.clear()
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item):
        """The test itself."""
        began = time.perf_counter()
        try:
            return (yield)
        finally:
            self.took[item.nodeid] = time.perf_counter() - began
            self.own[item.nodeid] = set(self.now)
            self.now.clear()


class Only:
    """A plugin of pytest that keeps the tests which run one function, the fastest of every file first."""

    def __init__(self, reach: Reach, code: CodeType | None):
        self.reach, self.code = reach, code  # None for all of them

    def pytest_collection_modifyitems(self, items):
        """The files, too, by their fastest test."""
        took, own, always, fastest = self.reach.took, self.reach.own, self.reach.always, {}
        items[:] = sorted((item for item in items if self.code is None or self.code in own.get(item.nodeid, ())
                           or self.code in always.get(item.path, ())), key=lambda item: took.get(item.nodeid, 0.0))
        for item in items:
            fastest.setdefault(item.path, len(fastest))
        items.sort(key=lambda item: fastest[item.path])


def run_tests(files, plugin) -> bool:
    """Whether all tests pass, or none is left to run."""
    def stop(*_):
        raise TimeoutError

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(LONGEST)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            end = pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow and not study",
                               "-W", "ignore::pytest.PytestAssertRewriteWarning", *files], plugins=[plugin])
        return end in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
    except TimeoutError:
        return False
    finally:
        signal.alarm(0)


def find_file(name: str) -> Path:
    """A module's source."""
    return ROOT / "ddetumble" / f"{name.replace('.', '/')}.py"


def digest(name: str) -> str:
    """The state of a module's code in a few digits."""
    return hashlib.sha256(find_file(name).read_bytes()).hexdigest()[:12]


def examine(name: str, files, most: int, seed: int) -> dict:
    """Mutants of one module and which were noticed."""
    module = importlib.import_module(f"ddetumble.{name}")
    path = find_file(name)
    source = ast.parse(path.read_text(encoding="utf-8"))
    sites = Sites()
    sites.visit(source)
    usable = []
    for number, (where, *_) in enumerate(sites.found):
        outer = where.split(".")
        owner = getattr(module, outer[0], None)
        holder = getattr(owner, outer[1], None) if isinstance(owner, type) and len(outer) > 1 else owner
        if isinstance(holder, property):
            holder = holder.fget
        if hasattr(holder, "__code__"):
            usable.append((number, holder, outer[: 2 if isinstance(owner, type) else 1]))
    reach = Reach({holder.__code__ for _, holder, _ in usable})
    passed = run_tests(files, reach)
    reach.close()
    if not passed:
        raise SystemExit(f"the tests of {name} fail without any change")
    chosen = random.Random(f"{seed} {name}").sample(usable, min(most, len(usable)))
    survivors, killed = [], 0
    for number, function, names in sorted(chosen, key=lambda one: one[0]):
        tree = copy.deepcopy(source)
        where, line, before, after = mutate(tree, number)
        kept = function.__code__
        function.__code__ = find_code(compile(tree, str(path), "exec"), names)
        try:
            passed = run_tests(files, Only(reach, kept))
        finally:
            function.__code__ = kept
        killed += not passed
        if passed:
            survivors.append({"function": where, "line": line, "before": before[:120], "after": after[:120]})
            print(f"  {name}:{line} {where}: {before[:60]} -> {after[:60]}", flush=True)
    if not run_tests(files, Only(reach, None)):
        raise SystemExit(f"the tests of {name} fail when they are run again: they leave something behind")
    return {"module": name, "sites": len(usable), "mutants": len(chosen), "killed": killed, "survivors": survivors,
            "tests": list(files), "code": digest(name), "seed": seed}


def tell(rows: list[dict], most: int) -> str:
    """The page."""
    total, killed = sum(r["mutants"] for r in rows), sum(r["killed"] for r in rows)
    old = [f"`{r['module']}`" for r in rows if r.get("code") != digest(r["module"])]
    lines = ["# Mutation testing of what decides a verdict", "",
             f"Made by `python -m benchmarks.mutation -o fits/mutation --most {most}`, which writes after every "
             "module: one operator, constant or returned value of one function changed at a time; a fixed sample of "
             "each module. With `--module` only some are sat anew. "
             f"Of {len(MODULES)} modules these are done: {', '.join(r['module'] for r in rows)}.", "",
             f"{killed} of {total} mutants are noticed ({100 * killed / max(total, 1):.0f} %).", "",
             "| module | places | mutants | noticed | tests |", "| --- | --- | --- | --- | --- |"]
    lines += [f"| `{r['module']}` | {r['sites']} | {r['mutants']} | {r['killed']} "
              f"({100 * r['killed'] / max(r['mutants'], 1):.0f} %) | {', '.join(f'`{f}`' for f in r['tests'])} |"
              for r in rows]
    if old:
        lines += ["", f"Of an earlier state of their code: {', '.join(old)}."]
    lines += ["", "Not noticed:", ""]
    lines += [f"- `{r['module']}` line {s['line']}, `{s['function']}`: `{s['before']}` → `{s['after']}`"
              for r in rows for s in r["survivors"]]
    return "\n".join([*lines, ""])


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--most", type=int, default=40, help="mutants a module")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--module", action="append", choices=list(MODULES), help="only these")
    given = parser.parse_args(arguments)
    result = given.output / "result.json"
    found = {r["module"]: r for r in json.loads(result.read_text(encoding="utf-8"))} if result.exists() else {}
    for name in given.module or MODULES:
        began = time.perf_counter()
        found[name] = row = examine(name, MODULES[name], given.most, given.seed)
        print(f"{name}: {row['killed']} of {row['mutants']}, {time.perf_counter() - began:.0f} s", flush=True)
        given.output.mkdir(parents=True, exist_ok=True)
        rows = [found[other] for other in MODULES if other in found]
        result.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        (given.output / "README.md").write_text(tell(rows, given.most), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
