"""Keeps photon records on disk, so that what was simulated once is not simulated again.

Knows nothing of any renderer: whoever simulates names everything that determines the records
(the key) and gives arrays; the same key brings them back, whole and unchanged or not at all.
"""

from mcrim_mitsuba.cache.chunk_file import Chunk
from mcrim_mitsuba.cache.location import cache_folder
from mcrim_mitsuba.cache.record_cache import RecordCache
from mcrim_mitsuba.cache.versions import record_versions

__all__ = ["Chunk", "RecordCache", "cache_folder", "record_versions"]
