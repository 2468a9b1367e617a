"""Nothing that is read can be executed: the sources use nothing that would."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from mobo_tuner.runs.run_id import check_run_id

ROOT = Path(__file__).resolve().parents[1]
SOURCES = [ROOT / "mobo.py", *(ROOT / "launcher").rglob("*.py"), *(ROOT / "src").rglob("*.py")]
MODULES = {"pickle", "cPickle", "dill", "marshal", "shelve", "joblib", "cloudpickle"}
BUILT_IN = {"eval", "exec", "compile", "__import__"}
SAFE_LOADERS = {"_UniqueKeyLoader", "SafeLoader", "CSafeLoader"}


def dangers(source: str) -> Iterator[str]:
    """What in a source could execute what is read."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name.split(".")[0] in MODULES)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in MODULES:
            yield str(node.module)
        elif isinstance(node, ast.Call):
            keywords = {k.arg: ast.unparse(k.value) for k in node.keywords}
            called = ast.unparse(node.func)
            loader = keywords.get("Loader", "").split(".")[-1]
            signs = (
                called in BUILT_IN,
                called in ("yaml.unsafe_load", "yaml.full_load", "os.system"),
                called == "yaml.load" and loader not in SAFE_LOADERS,
                keywords.get("allow_pickle") == "True",
                keywords.get("weights_only") == "False",
                keywords.get("shell") == "True",
            )
            if any(signs):
                yield called


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_nothing_executes_what_is_read(path: Path) -> None:
    assert list(dangers(path.read_text(encoding="utf-8"))) == []


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "eval(text)",
        "yaml.load(text)",
        "yaml.load(text, Loader=yaml.FullLoader)",
        "numpy.load(path, allow_pickle=True)",
        "subprocess.run(words, shell=True)",
    ],
)
def test_what_would_is_found(source: str) -> None:
    assert list(dangers(source))


@pytest.mark.parametrize(
    "run_id", ["../x", "/etc", "a/b", "", ".hidden", "x" * 101, "a\n", "ä", "-r"]
)
def test_a_run_cannot_leave_its_folder(run_id: str) -> None:
    with pytest.raises(ValueError, match="run_id is"):
        check_run_id(run_id)
