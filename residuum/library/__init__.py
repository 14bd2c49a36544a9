"""The library's faces: what `import residuum as rs` offers, and what the command line and the
service call.

Plain functions on the rooms below, records in and results out; `residuum/__init__.py` lists the
names.
"""
