"""Findings, windows and signal blocks on disk."""

from residuum.service.storage.disk_store import DiskStore

__all__ = ["DiskStore"]
