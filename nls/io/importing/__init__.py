"""Logs of a vehicle, text files and bags, as mission folders: a mapping says which column is which."""

from nls.io.importing.draft import draft
from nls.io.importing.mapping import Mapping, read_mapping
from nls.io.importing.mission import Imported, import_logs, write_imported
from nls.io.importing.templates import templates

__all__ = ["Imported", "Mapping", "draft", "import_logs", "read_mapping", "templates", "write_imported"]
