"""Results that leave the service as files: Parquet tables by time range, a machine's report of a
month.
"""
