"""What a process asks of the Linux kernel so that the bytes it reads cannot make it do harm. Elsewhere, nothing happens.

Three layers, each of which may be missing: sockets are refused by a filter of system calls, what root may do is given up,
and files are Landlock's (Linux 5.13). None of them takes any rights, so they hold within containers, too. Landlock also keeps
the process from looking into others: into the worker's environment, which holds credentials and belongs to the same user.
"""

import ctypes
import errno
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

PACKAGES = ("evaluator", "worker")
"""What a job imports of ours; the folder above may be a source tree that holds the data, too."""

SYSTEM_LIBRARIES = ("/usr/lib", "/usr/lib64", "/lib", "/lib64")
DEVICES = ("/dev/null", "/dev/full")
"""Files that libraries, and tests of full disks, may write to."""

_PR_SET_DUMPABLE, _PR_SET_SECCOMP, _PR_CAPBSET_DROP, _PR_SET_NO_NEW_PRIVS = 4, 22, 24, 38
_CAP_DAC_OVERRIDE = 1
_CAPABILITY_VERSION = 0x20080522
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_GET_VERSION = 1
_PATH_BENEATH = 1

# Instructions of seccomp(2)'s filters, and where they find the system call and the instruction set it is made in.
_LOAD, _IS_EQUAL, _IS_AT_LEAST, _RETURN = 0x20, 0x15, 0x35, 0x06
_NUMBER_OFFSET, _ARCHITECTURE_OFFSET = 0, 4
_ALLOW_CALL, _REFUSE_CALL = 0x7FFF0000, 0x00050000 | errno.EPERM
_FILTER_MODE = 2
_IO_URING_SETUP, _X32_CALLS = 425, 0x40000000
_SOCKET = {"x86_64": (0xC000003E, 41), "aarch64": (0xC00000B7, 198)}
"""By machine: its instruction set as filters see it, and the number of `socket`."""

# Rights of landlock(7): bit n of what is handled; beyond `_FIRST_BITS` each version of the kernel's interface adds some.
_EXECUTE, _WRITE_FILE, _READ_FILE, _READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
_MAKE_DEVICES_AND_SOCKETS = 1 << 6 | 1 << 9 | 1 << 11
_FIRST_BITS = 13
_ADDED_BITS = {2: 1 << 13, 3: 1 << 14, 5: 1 << 15}
_OTHER_PROCESSES = {6: 0b11}


class _Ruleset(ctypes.Structure):
    """What is refused: rights on files unless a rule allows it, TCP (never set), abstract sockets and signals."""

    _fields_ = (("files", ctypes.c_uint64), ("tcp", ctypes.c_uint64), ("scoped", ctypes.c_uint64))


class _PathBeneath(ctypes.Structure):
    """Rights on a file, or on all that a folder holds."""

    _pack_ = 1
    _fields_ = (("allowed", ctypes.c_uint64), ("parent", ctypes.c_int32))


class _Instruction(ctypes.Structure):
    """One step of a filter: the next ones to skip if it holds, and if not."""

    _fields_ = (("code", ctypes.c_uint16), ("yes", ctypes.c_uint8), ("no", ctypes.c_uint8), ("k", ctypes.c_uint32))


class _Filter(ctypes.Structure):
    """A filter of system calls."""

    _fields_ = (("length", ctypes.c_uint16), ("instructions", ctypes.POINTER(_Instruction)))


class _CapabilityHeader(ctypes.Structure):
    """Whose capabilities; 0: our own."""

    _fields_ = (("version", ctypes.c_uint32), ("process", ctypes.c_int))


def hide_memory() -> None:
    """Let no other process of our user read our memory and environment, nor those of processes we fork.

    `/proc/<process>/environ` then belongs to root; a program that is executed starts afresh.
    """
    _prctl(_PR_SET_DUMPABLE, 0)


def refuse_sockets() -> bool:
    """Let this process and its children make no socket of any kind, for the network or for this machine.

    Returns:
        False where the kernel or this machine has no such filter.
    """
    if not sys.platform.startswith("linux") or os.uname().machine not in _SOCKET or sys.maxsize < 1 << 32:
        return False
    architecture, socket = _SOCKET[os.uname().machine]
    steps = (
        (_LOAD, 0, 0, _ARCHITECTURE_OFFSET),
        (_IS_EQUAL, 0, 4, architecture),
        (_LOAD, 0, 0, _NUMBER_OFFSET),
        (_IS_AT_LEAST, 2, 0, _X32_CALLS),
        (_IS_EQUAL, 1, 0, socket),
        (_IS_EQUAL, 0, 1, _IO_URING_SETUP),  # which makes sockets, too
        (_RETURN, 0, 0, _REFUSE_CALL),
        (_RETURN, 0, 0, _ALLOW_CALL),
    )
    instructions = (_Instruction * len(steps))(*(_Instruction(*step) for step in steps))
    filter_ = _Filter(len(steps), instructions)
    return _prctl(_PR_SET_NO_NEW_PRIVS, 1) and _prctl(_PR_SET_SECCOMP, _FILTER_MODE, ctypes.addressof(filter_))


def drop_privileges() -> None:
    """Give up all that root can do, and getting it back by executing a program.

    Except for files, which `confine_files` is for: a worker that runs as root may use a data folder that another user owns.
    """
    capability = 0
    while _prctl(_PR_CAPBSET_DROP, capability):
        capability += 1
    kept = (ctypes.c_uint32 * 6)(1 << _CAP_DAC_OVERRIDE, 1 << _CAP_DAC_OVERRIDE)  # effective, permitted
    if not _capset(kept):
        _capset((ctypes.c_uint32 * 6)())  # it was not ours to keep
    _prctl(_PR_SET_NO_NEW_PRIVS, 1)


def can_confine_files() -> bool:
    """Say whether the kernel has Landlock and this process may use it."""
    return _landlock_version() > 0


def confine_files(folder: Path, inputs: Iterable[Path]) -> bool:
    """Let this process and its children use no other files: read `inputs`, do everything in `folder`, import.

    Files that are open stay usable. Signals to other processes and a look into their memory are refused as well, as far
    as the kernel knows how to. Where an input is missing, reading it tells that.

    Returns:
        False when the kernel does not do it; then nothing is refused.
    """
    version = _landlock_version()
    if version <= 0:
        return False
    handled = (1 << _FIRST_BITS) - 1 | _since(version, _ADDED_BITS)
    try:
        with _ruleset(_Ruleset(handled, 0, _since(version, _OTHER_PROCESSES))) as ruleset:
            _allow(ruleset, [folder], handled & ~(_EXECUTE | _MAKE_DEVICES_AND_SOCKETS))
            _allow(ruleset, inputs, _READ_FILE)
            _allow(ruleset, _program_folders(), _READ_FILE | _READ_DIR)
            _allow(ruleset, map(Path, DEVICES), _READ_FILE | _WRITE_FILE)
            _prctl(_PR_SET_NO_NEW_PRIVS, 1)
            _system_call(_RESTRICT_SELF, ruleset, 0)
    except OSError:
        return False
    return True


def _program_folders() -> Iterator[Path]:
    """Yield where Python, its packages, ours and the system's libraries are."""
    root = Path(__file__).resolve().parent.parent
    yield from (root / package for package in PACKAGES)
    yield from (Path(entry) for entry in sys.path if entry and Path(entry).resolve() != root)
    yield from map(Path, (sys.prefix, sys.base_prefix, *SYSTEM_LIBRARIES))


@contextmanager
def _ruleset(attributes: _Ruleset) -> Iterator[int]:
    descriptor = _system_call(_CREATE_RULESET, ctypes.byref(attributes), ctypes.sizeof(attributes), 0)
    with closing(os.fdopen(descriptor, "rb", buffering=0)):
        yield descriptor


def _allow(ruleset: int, paths: Iterable[Path], rights: int) -> None:
    """Allow rights on paths, where there are such."""
    for path in paths:
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
            try:
                rule = _PathBeneath(rights, descriptor)
                _system_call(_ADD_RULE, ruleset, _PATH_BENEATH, ctypes.byref(rule), 0)
            finally:
                os.close(descriptor)


def _since(version: int, rights: dict[int, int]) -> int:
    """Join the rights that the kernel's version knows."""
    return sum(bits for first, bits in rights.items() if first <= version)


def _landlock_version() -> int:
    try:
        return _system_call(_CREATE_RULESET, None, 0, _GET_VERSION)
    except OSError:
        return 0


def _system_call(number: int, *arguments: object) -> int:
    """Make a system call that the C library has no function for.

    Raises:
        OSError: The kernel refuses, or this is no Linux.
    """
    if not sys.platform.startswith("linux"):
        raise OSError("only Linux has it")
    library = ctypes.CDLL(None, use_errno=True)
    answer: int = library.syscall(ctypes.c_long(number), *arguments)
    if answer < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return answer


def _prctl(option: int, value: int, more: int = 0) -> bool:
    """Change something of this process; False where that does not go."""
    try:
        prctl = ctypes.CDLL(None).prctl
    except (AttributeError, OSError):
        return False
    return bool(prctl(option, *map(ctypes.c_ulong, (value, more, 0, 0))) == 0)


def _capset(sets: ctypes.Array[ctypes.c_uint32]) -> bool:
    """Set effective, permitted and inheritable capabilities, first 0 to 31, then 32 to 63."""
    try:
        capset = ctypes.CDLL(None).capset
    except (AttributeError, OSError):
        return False
    return bool(capset(ctypes.byref(_CapabilityHeader(_CAPABILITY_VERSION, 0)), sets) == 0)
