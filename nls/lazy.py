"""Packages whose names are imported when they are first used: ``import nls`` and ``import sim`` then cost nothing.

The packages of this library have names that other programs use, too. `refuse_shadows` asks Python where it would import
them from, and imports none.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from typing import Any

__all__ = ["importer", "postpone", "refuse_shadows"]

SIBLINGS = ("models", "factors", "sim")  # installed beside `nls`


def importer(
    package: str, where: Mapping[str, str], *more: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """The ``__getattr__``, the ``__dir__`` and the ``__all__`` of a package.

    Parameters
    ----------
    package : its name.
    where : by module the names that are imported when they are first used, with spaces between them.
    more : modules of the package that are public names of it.

    Returns
    -------
    get : of a name: a public object or a module of the package, imported now and kept. Raises AttributeError for
        others.
    names : what ``dir`` shows: ``__all__`` and what Python knows of every module.
    public : the names.
    """
    modules = {name: module for module, names in where.items() for name in names.split()}

    def get(name: str) -> Any:
        if name in modules:
            try:
                module = import_module(modules[name])
            except ImportError:
                refuse_shadows()  # one that came after `import nls`
                raise
            value = getattr(module, name)
        elif name.startswith("_"):
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        else:
            try:
                value = import_module(f"{package}.{name}")
            except ModuleNotFoundError as error:
                if error.name != f"{package}.{name}":
                    raise
                raise AttributeError(f"module {package!r} has no attribute {name!r}") from None
        setattr(sys.modules[package], name, value)
        return value

    def shown() -> list[str]:
        module = vars(sys.modules[package])
        return sorted({*module["__all__"], *(name for name in module if name.startswith("__"))})

    return get, shown, sorted([*modules, *more])


def postpone(package: str, names: Sequence[str]) -> None:
    """Import a package of other people, some of its modules only when they are used; nothing if it is imported already.

    Parameters
    ----------
    package : its name.
    names : of modules that it does not import itself.
    """
    if package in sys.modules:
        return
    from importlib.util import LazyLoader, find_spec, module_from_spec

    whole = import_module(package)
    for name in names:
        spec = find_spec(f"{package}.{name}")
        if spec is None or spec.loader is None:
            continue
        spec.loader = LazyLoader(spec.loader)
        module = sys.modules[spec.name] = module_from_spec(spec)
        spec.loader.exec_module(module)
        setattr(whole, name, module)


def refuse_shadows() -> None:
    """Raise one ImportError if Python takes another package or module for one of ours; 0.1 ms.

    Raises
    ------
    ImportError
        Names the file that shadows ours, and the ways out.
    """
    root = os.path.dirname(os.path.dirname(__file__))
    for name in SIBLINGS:
        loaded = sys.modules.get(name)
        spec = _spec(name) if loaded is None else None
        if loaded is None and spec is None:
            continue  # no package of this name at all: its import says so
        path = _path(spec) if loaded is None else _path(loaded)
        ours = os.path.join(root, name)
        if not _same(path, ours):
            raise ImportError(_sentence(name, path, ours, loaded is not None), name=name, path=path) from None


def _spec(name: str) -> Any:
    """Where a package would be imported from. `importlib.util.find_spec` does the same, and its import takes 2 ms."""
    specs = (finder.find_spec(name, None) for finder in sys.meta_path if hasattr(finder, "find_spec"))
    return next((spec for spec in specs if spec is not None), None)


def _path(package: Any) -> str | None:
    """File of a module or of a spec; the folder of a package without ``__init__.py``; None where there is neither."""
    file = getattr(package, "__file__", None) or (package.origin if getattr(package, "has_location", False) else None)
    folders = getattr(package, "__path__", None) or getattr(package, "submodule_search_locations", None)
    return str(file) if file else next(iter(folders or ()), None)


def _same(path: str | None, ours: str) -> bool:
    """Whether a file is the ``__init__`` of our package, under whichever name of its folder."""
    if path is None:
        return False
    folder = os.path.dirname(path)
    return folder == ours or (os.path.isdir(folder) and os.path.isdir(ours) and os.path.samefile(folder, ours))


def _sentence(name: str, path: str | None, ours: str, loaded: bool) -> str:
    where = path or "a module without a file"
    state = "was imported before" if loaded else "comes first on sys.path"
    return f"""another {name!r} shadows the package {name!r} of leadline.
  In the way: {where} ({state})
  Expected:   {ours}
Ways out, one is enough:
  1. Rename the other one.
  2. If it is in the folder of your script or in the current folder: run from another folder, or with `python -P`.
  3. If it is installed, or on PYTHONPATH: install leadline into a virtual environment of its own."""
