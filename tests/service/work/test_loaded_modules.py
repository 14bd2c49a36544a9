import subprocess
import sys

SCRIPT = """
import gc
from residuum.service.work.loaded_modules import leave_loaded_modules
leave_loaded_modules()
first = gc.get_freeze_count()
later = [[] for _ in range(1000)]
leave_loaded_modules()
print(first > 1000, gc.get_freeze_count() <= first)
"""


def test_what_is_loaded_is_left_alone_and_what_comes_later_is_not():
    found = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    assert found.stdout.split() == ["True", "True"]


IMPORTS = """
import gc
from residuum.service.work.loaded_modules import loading_modules
with loading_modules():
    print(gc.isenabled())
print(gc.isenabled(), gc.get_freeze_count() > 1000)
"""


def test_nothing_is_collected_while_modules_are_loaded():
    found = subprocess.run(
        [sys.executable, "-c", IMPORTS], capture_output=True, text=True, check=True
    )
    assert found.stdout.split() == ["False", "True", "True"]
