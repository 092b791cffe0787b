#!/usr/bin/env python3
"""Runs a command with the system calls and capabilities that Docker leaves a container by default.

    tools/docker_calls.py target/debug/joulebus run --config fleet.toml

The kernel enforces it: a seccomp filter answers EPERM to the calls that Docker's default profile
(moby, July 2024) does not list, ENOSYS to `clone3` and to calls newer than the profile. A process
of root loses the capabilities that Docker takes away, and may lock 8 MiB. Children inherit all of
this. Needs a C compiler, whose headers have the numbers of the calls. Ends with 125 if the kernel
or the headers lack something, otherwise as the command does.
"""

import ctypes
import errno
import os
import re
import resource
import struct
import subprocess
import sys

# Calls of Linux up to 6.0 that the profile does not list, or lists for more capabilities alone.
FORBIDDEN = """
    _sysctl acct add_key afs_syscall bpf clock_settime create_module delete_module fanotify_init finit_module fsconfig
    fsmount fsopen fspick get_kernel_syms get_mempolicy getpmsg init_module io_uring_enter io_uring_register
    io_uring_setup ioperm iopl kcmp kexec_file_load kexec_load keyctl lookup_dcookie mbind migrate_pages mount
    mount_setattr move_mount move_pages nfsservctl open_by_handle_at open_tree perf_event_open pidfd_getfd pivot_root
    process_madvise putpmsg query_module quotactl quotactl_fd reboot request_key security set_mempolicy
    set_mempolicy_home_node setdomainname sethostname setns settimeofday swapoff swapon sysfs syslog tuxcall umount
    umount2 unshare uselib userfaultfd ustat vhangup vserver
""".split()
NEWEST = "set_mempolicy_home_node"
# CHOWN, DAC_OVERRIDE, FOWNER, FSETID, KILL, SETGID, SETUID, SETPCAP, NET_BIND_SERVICE, NET_RAW,
# SYS_CHROOT, MKNOD, AUDIT_WRITE, SETFCAP
CAPABILITIES = {0, 1, 3, 4, 5, 6, 7, 8, 10, 13, 18, 27, 29, 31}
LOCKED_BYTES = 8 << 20
NEW_NAMESPACES = 0x7E020000
AF_VSOCK = 40
PERSONALITIES = (0, 8, 0x20000, 0x20008, 0xFFFFFFFF)

LOAD, EQUAL, GREATER, ANY_BIT, RETURN = 0x20, 0x15, 0x25, 0x45, 0x06
ALLOWED, REFUSED = 0x7FFF0000, 0x00050000
PR_CAPBSET_DROP, PR_SET_SECCOMP, PR_SET_NO_NEW_PRIVS, FILTER = 24, 22, 38, 2


def numbers():
    """The numbers of system calls, by name."""
    headers = subprocess.run(["cc", "-E", "-dM", "-x", "c", "-"], input="#include <sys/syscall.h>\n", text=True,
                             capture_output=True, check=True).stdout
    return {name: int(number) for name, number in re.findall(r"^#define __NR_(\w+) (\d+)$", headers, re.M)}


def program(calls):
    """The filter, as classic BPF over `struct seccomp_data`."""
    lines = []

    def add(code, value, if_true=0, if_false=0):
        lines.append(struct.pack("=HBBI", code, if_true, if_false, value))

    def refuse(code, call, error):
        add(code, call, 0, 1)
        add(RETURN, REFUSED | error)

    add(LOAD, 0)
    for name in FORBIDDEN:
        if name in calls:
            refuse(EQUAL, calls[name], errno.EPERM)
    refuse(EQUAL, calls["clone3"], errno.ENOSYS)
    refuse(GREATER, calls[NEWEST], errno.ENOSYS)
    # By the lower half of the first argument, which both processors have first.
    add(EQUAL, calls["clone"], 0, 4)
    add(LOAD, 16)
    add(ANY_BIT, NEW_NAMESPACES, 0, 1)
    add(RETURN, REFUSED | errno.EPERM)
    add(RETURN, ALLOWED)
    add(EQUAL, calls["socket"], 0, 4)
    add(LOAD, 16)
    add(EQUAL, AF_VSOCK, 0, 1)
    add(RETURN, REFUSED | errno.EPERM)
    add(RETURN, ALLOWED)
    add(EQUAL, calls["personality"], 0, 2 + len(PERSONALITIES))
    add(LOAD, 16)
    for at, allowed in enumerate(PERSONALITIES):
        add(EQUAL, allowed, len(PERSONALITIES) - at)
    add(RETURN, REFUSED | errno.EPERM)
    add(RETURN, ALLOWED)
    return lines


def confine():
    """Puts this process under the filter."""
    libc = ctypes.CDLL(None, use_errno=True)

    def prctl(option, second, third=None):
        third = third or ctypes.c_ulong(0)
        if libc.prctl(option, ctypes.c_ulong(second), third, ctypes.c_ulong(0), ctypes.c_ulong(0)):
            raise OSError(ctypes.get_errno(), f"prctl {option}")

    lines = program(numbers())
    if os.geteuid() == 0:
        with open("/proc/sys/kernel/cap_last_cap", encoding="ascii") as last:
            for capability in set(range(int(last.read()) + 1)) - CAPABILITIES:
                prctl(PR_CAPBSET_DROP, capability)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (LOCKED_BYTES, LOCKED_BYTES))
    code = ctypes.create_string_buffer(b"".join(lines))
    described = struct.pack("@HP", len(lines), ctypes.addressof(code))
    prctl(PR_SET_NO_NEW_PRIVS, 1)
    prctl(PR_SET_SECCOMP, FILTER, ctypes.c_char_p(described))


def main():
    if len(sys.argv) < 2:
        print(__doc__, file=sys.stderr)
        return 2
    try:
        confine()
    except (OSError, KeyError, ValueError, subprocess.CalledProcessError) as error:
        print(f"docker_calls.py: no filter here: {error!r}", file=sys.stderr)
        return 125
    os.execvp(sys.argv[1], sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
