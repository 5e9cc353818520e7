"""Logs of a vehicle, text files and bags, as mission folders: a mapping says which column is which."""

from nls.missions.importing.draft import draft
from nls.missions.importing.mapping import Mapping, read_mapping
from nls.missions.importing.mission import Imported, import_logs, write_imported
from nls.missions.importing.templates import templates

__all__ = ["Imported", "Mapping", "draft", "import_logs", "read_mapping", "templates", "write_imported"]
