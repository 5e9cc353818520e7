"""Files: `load` reads a graph, its start and a report, from a file or a mission folder; `save` writes a graph file."""

from nls.lazy import importer

TYPE_CHECKING = False  # to a type checker always true
if TYPE_CHECKING:
    from nls.io.formats import DIALECTS as DIALECTS
    from nls.io.graph_files import load as load, load_stream as load_stream, rendered as rendered, save as save
    from nls.io.native.structure import register as register
    from nls.io.report import LoadReport as LoadReport, Source as Source
    from nls.io.trajectory import (
        read_kitti as read_kitti,
        read_tum as read_tum,
        write_kitti as write_kitti,
        write_tum as write_tum,
    )

_WHERE = {
    "nls.io.formats": "DIALECTS",
    "nls.io.graph_files": "load load_stream rendered save",
    "nls.io.native.structure": "register",
    "nls.io.report": "LoadReport Source",
    "nls.io.trajectory": "read_kitti read_tum write_kitti write_tum",
}

if not TYPE_CHECKING:
    __getattr__, __dir__, __all__ = importer("nls.io", _WHERE)
    del importer, TYPE_CHECKING
