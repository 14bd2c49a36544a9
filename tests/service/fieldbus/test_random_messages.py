"""Messages drawn at random, multiplexed ones among them: every value of every frame is cantools' own."""

import cantools
import numpy as np
import pytest
from cantools.database.errors import DecodeError

from residuum.service.fieldbus.can.frame_layout import read_dbc

MESSAGES = 50
FRAMES = 60


def free_place(rng, length, taken, bits):
    """A start bit and byte order at which so many bits of a message are still free; None when none was found."""
    for _ in range(60):
        little = bool(rng.integers(2))
        first = int(rng.integers(8 * length - bits + 1))
        # a little-endian signal fills bits upwards, a big-endian one bytes onwards from their highest bits
        places = {
            first + k if little else 8 * ((first + k) // 8) + 7 - (first + k) % 8
            for k in range(bits)
        }
        if not places & taken:
            start = first if little else 8 * (first // 8) + 7 - first % 8
            return start, little, places
    return None


def signal_line(rng, name, mark, place, bits, kind):
    start, little, _ = place
    scale, offset = rng.choice([1.0, 0.5, -0.25, 0.01, 3.0]), rng.choice([0.0, 0.0, -40.0, 1.5])
    if mark.endswith("M"):
        scale, offset = 1.0, 0.0
    sign = "-" if kind == "signed" else "+"
    return (
        f' SG_ {name}{mark} : {start}|{bits}@{int(little)}{sign} ({scale:g},{offset:g}) [0|0] "" A'
    )


def random_message(rng, number):
    """Lines of one message, of its floating-point types, and of its extended multiplexing."""
    length, extended = int(rng.choice([3, 8, 8, 8, 12, 64])), number % 5 == 4
    lines, floats, ranges, taken = [], [], [], set()

    def add(name, mark, bits, kind, occupied):
        place = free_place(rng, length, occupied, bits)
        if place is None:
            return False
        lines.append(signal_line(rng, name, mark, place, bits, kind))
        if kind == "float":
            floats.append(f"SIG_VALTYPE_ {600 + number} {name} : {1 if bits == 32 else 2};")
        occupied |= place[2]
        return True

    def add_some(stem, mark, most, occupied):
        for k in range(int(rng.integers(1, most))):
            kind = rng.choice(["signed", "unsigned", "unsigned", "float"])
            bits = (
                int(rng.choice([32, 64]))
                if kind == "float"
                else int(rng.choice([1, 4, 8, 11, 16, 31, 33, 57, 64]))
            )
            if bits <= 8 * length:
                add(f"{stem}_{k:02d}", mark, bits, kind, occupied)

    multiplexed = number % 2 == 1 and add("page", " M", 3, "unsigned", taken)
    if multiplexed:
        pages = []
        for page in range(3):
            of_page = set(taken)
            if extended and page == 2:
                if add("inner", f" m{page}M", 2, "unsigned", of_page):
                    ranges.append(f"SG_MUL_VAL_ {600 + number} inner page {page}-{page};")
                    before = len(lines)
                    add_some("deep", " m1", 3, of_page)
                    ranges += [
                        f"SG_MUL_VAL_ {600 + number} {line.split()[1]} inner 1-2;"
                        for line in lines[before:]
                    ]
            else:
                before = len(lines)
                add_some(f"p{page}", f" m{page}", 4, of_page)
                if extended:
                    ranges += [
                        f"SG_MUL_VAL_ {600 + number} {line.split()[1]} page {page}-{page};"
                        for line in lines[before:]
                    ]
            pages.append(of_page)
        taken = set().union(*pages)
    add_some("s", "", 5, taken)
    if not lines:
        lines.append(' SG_ s_00 : 0|1@1+ (1,0) [0|0] "" A')
    return [f"BO_ {600 + number} m{number}: {length} A", *lines], floats, ranges


@pytest.fixture(scope="module")
def random_dbc(tmp_path_factory):
    rng = np.random.default_rng(40)
    messages, floats, ranges = zip(
        *(random_message(rng, number) for number in range(MESSAGES)), strict=True
    )
    text = 'VERSION ""\nBS_:\nBU_: A\n' + "\n".join("\n".join(lines) + "\n" for lines in messages)
    file = tmp_path_factory.mktemp("random") / "random.dbc"
    file.write_text(text + "\n".join(line for lines in (*floats, *ranges) for line in lines) + "\n")
    return file


def test_every_value_of_fifty_random_messages_is_that_of_cantools(random_dbc):
    layouts, reference = read_dbc(random_dbc), cantools.database.load_file(str(random_dbc))
    assert len(layouts) == MESSAGES and not layouts.unusable
    rng, compared, missing = np.random.default_rng(41), 0, 0
    for name, layout in layouts.items():
        message = reference.get_message_by_name(name)
        frames = rng.integers(0, 256, (FRAMES, layout.length), dtype=np.uint8)
        _, channels = layout.decode(frames)
        for k, frame in enumerate(frames):
            try:
                told = message.decode(frame.tobytes(), decode_choices=False)
            except DecodeError:
                # a page that the file does not know: cantools gives nothing of such a frame
                continue
            for channel, values in channels.items():
                right = float(told.get(channel, np.nan))
                # beyond 2⁵³ cantools reckons in whole numbers and rounds once, here twice: the last bit may differ
                beyond = np.spacing(abs(right)) if abs(right) > 2**53 else 0.0
                same = (np.isnan(values[k]) and np.isnan(right)) or abs(values[k] - right) <= beyond
                assert same or values[k] == right, (name, channel, values[k], right)
                compared += 1
                missing += channel not in told
    multiplexed = [message for message in reference.messages if message.is_multiplexed()]
    assert len(multiplexed) >= 20 and compared > 4000 and missing > 500
