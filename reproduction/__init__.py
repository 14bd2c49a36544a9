"""The source's figures and tables beside ours; `python -m reproduction` writes report.html."""
