"""Decode the frames of a blackbox log, whose fields have variable lengths and depend on the frames before them.

Letters: B bytes, K kinds of frames, F fields, M rows of the main frames, N rows of all other frames.

Source: Betaflight documentation, *Blackbox Internals*, for frames, encodings and predictors; order of the frames' bits as in
Betaflight's ``blackbox_encoding.c`` (data version 2).
"""

import warp as wp

INTRA, INTER, SLOW, GPS, HOME, EVENT = range(6)
LETTERS = "IPSGHE"  # First byte of a frame of each kind
ENCODINGS = (0, 1, 3, 6, 7, 8, 9, 10)  # Codes that ``_read_group`` knows
FOUR = 8  # Code of four numbers of 0, 4, 8 or 16 bits
LONGEST_JUMP_US = 10_000_000  # A larger step of time [us] between two frames shows a damaged frame

# Places of the constants of a flight, and of the results
MIN_THROTTLE, VBAT_REF, MIN_MOTOR, MOTOR_0, I_INTERVAL, P_NUM, P_DENOM = range(7)
MAIN_ROWS, OTHER_ROWS, DAMAGED, LOST = range(4)

# Further predictors and events. Source: blackbox_fielddefs.h of Betaflight
HOME_COORDINATE, HOME_LONGITUDE = 7, 256  # The second number stands for the predictor 7 of the second coordinate
ADJUSTMENT, RESUME, GTUNE, END = 13, 14, 20, 255


@wp.func
def _read_byte(data: wp.array[wp.uint8], cursor: wp.array[int]):
    """Return the next byte, 0 beyond the end, and advance."""
    place = cursor[0]
    cursor[0] = place + 1
    byte = wp.int32(0)
    if place < cursor[1]:
        byte = int(data[place])
    return byte


@wp.func
def _read_unsigned(data: wp.array[wp.uint8], cursor: wp.array[int]):
    """Return an unsigned number of 7 bits a byte, lowest first; the top bit marks a further byte."""
    value = wp.int32(0)
    shift = wp.int32(0)
    while shift < 35:
        byte = _read_byte(data, cursor)
        value = value | ((byte & 127) << shift)
        shift += 7
        if byte < 128:
            shift = 35
    return value


@wp.func
def _read_signed(data: wp.array[wp.uint8], cursor: wp.array[int]):
    """Return a signed number, stored unsigned in the order 0, -1, 1, -2, ..."""
    value = _read_unsigned(data, cursor)
    return ((value >> 1) & 0x7FFFFFFF) ^ -(value & 1)


@wp.func
def _read_little_endian(data: wp.array[wp.uint8], cursor: wp.array[int], size: int):
    """Return a signed number of some bytes, lowest byte first."""
    value = wp.int32(0)
    for i in range(size):
        value = value | (_read_byte(data, cursor) << (8 * i))
    return _extend_sign(value, 8 * size)


@wp.func
def _extend_sign(value: int, bits: int):
    """Return the lowest bits of a number as a signed number."""
    shift = 32 - bits
    return (value << shift) >> shift


@wp.func
def _read_three(data: wp.array[wp.uint8], cursor: wp.array[int], uneven: bool, out: wp.array[int], at: int):
    """Read three numbers of 2, of 4 and of 6 bits, or of whole bytes each; ``uneven``: of 5, 5, 4 and of 8, 7, 7 bits."""
    lead = _read_byte(data, cursor)
    form = lead >> 6
    if form == 3:
        for i in range(3):
            out[at + i] = _read_little_endian(data, cursor, 1 + ((lead >> (2 * i)) & 3))
    elif form > 0 and uneven:
        for _ in range(form):
            lead = (lead << 8) | _read_byte(data, cursor)
        last = 3 * form + 1  # bits of the third number; the second one has 5 or 7
        out[at] = _extend_sign(lead >> (last + 3 + 2 * form), 3 * form + 2)
        out[at + 1] = _extend_sign(lead >> last, 3 + 2 * form)
        out[at + 2] = _extend_sign(lead, last)
    else:
        for _ in range(form):
            lead = (lead << 8) | _read_byte(data, cursor)
        gap = wp.max(4 * form, 2)  # distance of the numbers: 2, 4 or 8 bits
        for i in range(3):
            out[at + i] = _extend_sign(lead >> (gap * (2 - i)), 2 + 2 * form)


@wp.func
def _read_four(data: wp.array[wp.uint8], cursor: wp.array[int], out: wp.array[int], at: int):
    """Read four numbers of 0, 4, 8 or 16 bits, whose nibbles follow each other, highest first."""
    forms = _read_byte(data, cursor)
    held = wp.int32(0)  # the last byte, if its lower nibble is unread
    half = wp.int32(0)
    for i in range(4):
        form = (forms >> (2 * i)) & 3
        bits = 0
        if form > 0:
            bits = 2 << form
        value = wp.int32(0)
        nibbles = bits >> 2
        while nibbles > 0:
            if half == 0:
                held = _read_byte(data, cursor)
                value = (value << 4) | (held >> 4)
            else:
                value = (value << 4) | (held & 15)
            half = 1 - half
            nibbles -= 1
        if bits > 0:
            value = _extend_sign(value, bits)
        out[at + i] = value


@wp.func
def _read_group(
    data: wp.array[wp.uint8], cursor: wp.array[int], encodings: wp.array2d[int], kind: int, field: int, count: int,
    out: wp.array[int],
):  # fmt: skip
    """Read the fields that share a code, from ``field`` on, and return their number."""
    code = encodings[kind, field]
    size = wp.int32(1)
    if code == 0:
        out[field] = _read_signed(data, cursor)
    elif code == 1:
        out[field] = _read_unsigned(data, cursor)
    elif code == 3:
        out[field] = -_extend_sign(_read_unsigned(data, cursor), 14)
    elif code == 6:
        while size < 8 and field + size < count and encodings[kind, field + size] == 6:
            size += 1
        marks = wp.int32(1)
        if size > 1:
            marks = _read_byte(data, cursor)
        for i in range(size):
            out[field + i] = 0
            if ((marks >> i) & 1) == 1:
                out[field + i] = _read_signed(data, cursor)
    elif code == 7 or code == 10:
        _read_three(data, cursor, code == 10, out, field)
        size = 3
    elif code == 8:
        _read_four(data, cursor, out, field)
        size = 4
    else:
        out[field] = 0
    return size


@wp.func
def _count_unlogged(constants: wp.array[int], iteration: int):
    """Return the number of loop iterations after ``iteration`` that the firmware does not log."""
    count = wp.int32(0)
    going = wp.int32(1)
    while going == 1:
        place = (iteration + 1 + count) % constants[I_INTERVAL]
        if (place + constants[P_NUM] - 1) % constants[P_DENOM] < constants[P_NUM] or count >= constants[I_INTERVAL]:
            going = wp.int32(0)
        else:
            count += 1
    return count


@wp.func
def _add_prediction(
    frame: wp.array[int], field: int, code: int, has_sign: bool, before: wp.array2d[int], last: int, last_but_one: int,
    home: wp.array[int], constants: wp.array[int],
):  # fmt: skip
    """Add the prediction from earlier frames to a field."""
    value = wp.int32(0)
    if code == 4:
        value = constants[MIN_THROTTLE]
    elif code == 5:
        value = frame[constants[MOTOR_0]]
    elif code == HOME_COORDINATE:
        value = home[0]
    elif code == HOME_LONGITUDE:
        value = home[1]
    elif code == 8:
        value = 1500
    elif code == 9:
        value = constants[VBAT_REF]
    elif code == 11:
        value = constants[MIN_MOTOR]
    elif last >= 0:
        newest = before[field, last]
        if code == 1:
            value = newest
        elif code == 2:
            value = 2 * newest - before[field, last_but_one]
        elif code == 3 and has_sign:
            value = int((wp.int64(newest) + wp.int64(before[field, last_but_one])) / wp.int64(2))
        elif code == 3:
            value = int((wp.uint32(newest) + wp.uint32(before[field, last_but_one])) / wp.uint32(2))
        elif code == 6:
            value = newest + 1 + _count_unlogged(constants, newest)
        elif code == 10:
            value = before[1, last]
    frame[field] = frame[field] + value


@wp.func
def _read_event(data: wp.array[wp.uint8], cursor: wp.array[int], frame: wp.array[int]):
    """Read code and values of an event into ``frame``; return whether the event is known."""
    code = _read_byte(data, cursor)
    frame[0] = code
    frame[1] = 0
    frame[2] = 0
    known = wp.bool(True)
    if code == 0 or code == 15 or code == 40:  # beep, disarmed, failure of the IMU
        frame[1] = _read_unsigned(data, cursor)
    elif code == 14 or code == 30:  # resumed, flight modes
        frame[1] = _read_unsigned(data, cursor)
        frame[2] = _read_unsigned(data, cursor)
    elif code == ADJUSTMENT:
        frame[1] = _read_byte(data, cursor)
        if frame[1] < 128:
            frame[2] = _read_signed(data, cursor)
        else:
            frame[2] = _read_little_endian(data, cursor, 4)
    elif code == GTUNE:
        frame[1] = _read_byte(data, cursor)
        frame[2] = _read_signed(data, cursor)
        cursor[0] = cursor[0] + 2
    elif code == END:  # text 'End of log' and a zero
        known = _read_byte(data, cursor) == 69 and _read_byte(data, cursor) == 110
        cursor[0] = cursor[0] + 9
    else:
        known = wp.bool(False)
    return known


@wp.func
def _is_step(before: int, after: int):
    """Return whether a counter of microseconds advanced by a plausible time."""
    step = after - before
    return step >= 0 and step <= LONGEST_JUMP_US


@wp.kernel(enable_backward=False)
def decode_frames(
    # log
    data: wp.array[wp.uint8],  # (B,) bytes of the file
    cursor: wp.array[int],  # (2,) first byte of the frames, and the first byte behind them
    # definitions
    kind_of_byte: wp.array[int],  # (256,) kind of the frame that a byte begins; -1: none
    counts: wp.array[int],  # (K,) number of fields
    encodings: wp.array2d[int],  # (K, F)
    predictors: wp.array2d[int],  # (K, F)
    has_sign: wp.array2d[int],  # (K, F)
    constants: wp.array[int],  # header entries by the places above
    # scratch
    frame: wp.array[int],  # (F + 8,)
    home: wp.array[int],  # (2,)
    # out
    main_out: wp.array2d[int],  # (F, M) main frames
    other_out: wp.array2d[int],  # (N, F + 2) kind, time [us] and fields of other frames
    counts_out: wp.array[int],  # (4,) number of main and of other rows, of damaged and of lost frames
):
    """Decode all frames of one flight; damaged frames, and frames that depend on them, are left out."""
    main = wp.int32(0)
    other = wp.int32(0)
    intact = wp.bool(False)  # Whether the frame before a frame was decoded
    resumed = wp.bool(True)  # Whether the clock may have jumped
    last_is_intra = wp.bool(False)
    refused = wp.int32(0)  # Time of the last intra frame that did not fit its predecessor
    damaged_run = wp.bool(False)
    while cursor[0] < cursor[1]:
        start = cursor[0]
        kind = kind_of_byte[_read_byte(data, cursor)]
        good = kind >= 0
        if kind == EVENT:
            good = _read_event(data, cursor, frame)
        elif kind >= 0:
            field = wp.int32(0)
            count = counts[kind]
            while field < count:
                field += _read_group(data, cursor, encodings, kind, field, count, frame)
            last = main - 1
            last_but_one = wp.max(last, 0)
            if kind == INTER and not last_is_intra:
                last_but_one = wp.max(last - 1, 0)
            for i in range(count):
                code = predictors[kind, i]
                _add_prediction(frame, i, code, has_sign[kind, i] == 1, main_out, last, last_but_one, home, constants)
        end = cursor[0]
        if good:
            good = end == cursor[1]
            if end < cursor[1]:
                good = kind_of_byte[int(data[end])] >= 0
        if not good:
            if not damaged_run:
                counts_out[DAMAGED] = counts_out[DAMAGED] + 1
            damaged_run = wp.bool(True)
            intact = wp.bool(False)
            cursor[0] = start + 1
        elif kind < SLOW:
            damaged_run = wp.bool(False)
            time = frame[1]
            fits = resumed
            if main > 0:
                fits = _is_step(main_out[1, main - 1], time) or resumed
            if kind == INTRA:
                fits = fits or _is_step(refused, time)
                refused = time
            else:
                fits = fits and intact
            if fits:
                for i in range(counts[INTRA]):
                    main_out[i, main] = frame[i]
                main += 1
                last_is_intra = kind == INTRA
                resumed = wp.bool(False)
            else:
                counts_out[LOST] = counts_out[LOST] + 1
            intact = fits
        else:
            damaged_run = wp.bool(False)
            other_out[other, 0] = kind
            other_out[other, 1] = 0
            if main > 0:
                other_out[other, 1] = main_out[1, main - 1]
            count = 3
            if kind != EVENT:
                count = counts[kind]
            for i in range(count):
                other_out[other, 2 + i] = frame[i]
            other += 1
            if kind == HOME:
                home[0] = frame[0]
                home[1] = frame[1]
            if kind == EVENT and frame[0] == RESUME:
                resumed = wp.bool(True)
            if kind == EVENT and frame[0] == END:
                cursor[0] = cursor[1]
    counts_out[MAIN_ROWS] = main
    counts_out[OTHER_ROWS] = other
