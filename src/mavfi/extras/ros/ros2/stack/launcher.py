"""Starts the processes of trials, each in the private network and mounts of its trial; ends them all.

    python launcher.py FD driver              forks drivers (driver.py), each with namespaces of its own
    python launcher.py FD node SCRIPT.py      forks the script's processes, if its form allows it
    python launcher.py FD plain               starts programs only

It runs under the Python of a ROS 2 installation (3.10 or later, standard library and rclpy), without mavfi.  FD is a
connected socket; each request is a line of JSON, and so is its reply:

    {"do": "ready"}                            {"forks": true}
    {"do": "drive"} and a socket beside it     {"pid": 71}
    {"do": "start", "command": [...], "namespace": 71, "log": "node.log"}      {"pid": 72}
    {"do": "end"}                              {"statuses": {"72": 9}}

A fork costs a fiftieth of a start: ROS and the script are imported once, before ROS is initialized; a process that
already takes part in a graph cannot be forked.  Namespaces are entered by the child, so that this process stays where
it is.
"""

import ast
import contextlib
import ctypes
import fcntl
import importlib
import importlib.util
import json
import os
import signal
import socket
import struct
import sys

CLONE_NEWNS = 0x00020000  # <linux/sched.h>
CLONE_NEWNET = 0x40000000
IFF_UP = 0x1  # <net/if.h>
IFF_MULTICAST = 0x1000
SIOCGIFFLAGS = 0x8913  # <linux/sockios.h>
SIOCSIFFLAGS = 0x8914
PR_SET_PDEATHSIG = 1  # <linux/prctl.h>
PR_SET_CHILD_SUBREAPER = 36
LARGEST_REQUEST = 1 << 20

libc = ctypes.CDLL(None, use_errno=True)


def check(result):
    """Raise an `OSError` if a call of libc failed."""
    if result != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


# ---- namespaces ------------------------------------------------------------------------------------------------------
def unshare():
    """Give this process a network with loopback alone, and an empty /dev/shm."""
    check(libc.unshare(CLONE_NEWNET | CLONE_NEWNS))
    check(libc.mount(b"tmpfs", b"/dev/shm", b"tmpfs", 0, None))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = struct.pack("16sh14x", b"lo", 0)
        flags = struct.unpack("16sh14x", fcntl.ioctl(any_socket, SIOCGIFFLAGS, request))[1]
        # discovery is by multicast, which loopback does not have by default
        request = struct.pack("16sh14x", b"lo", flags | IFF_UP | IFF_MULTICAST)
        fcntl.ioctl(any_socket, SIOCSIFFLAGS, request)


def enter(pid):
    """Enter network and mounts of another process."""
    folder = os.getcwd()
    for kind, flag in (("net", CLONE_NEWNET), ("mnt", CLONE_NEWNS)):
        descriptor = os.open(f"/proc/{pid}/ns/{kind}", os.O_RDONLY)
        check(libc.setns(descriptor, flag))
        os.close(descriptor)
    os.chdir(folder)  # entering mounts leads to the root folder


# ---- scripts that can be forked --------------------------------------------------------------------------------------
def is_forkable(path):
    """Whether a script does nothing but define `main` and, as the main program, call it without arguments."""
    with open(path, encoding="utf-8") as file:
        tree = ast.parse(file.read(), path)
    defines = False
    calls = False
    for statement in tree.body:
        if isinstance(statement, ast.FunctionDef) and statement.name == "main":
            arguments = statement.args
            required = len(arguments.posonlyargs + arguments.args) - len(arguments.defaults)
            defines = required == 0
        elif isinstance(statement, ast.If) and ast.unparse(statement.test) == "__name__ == '__main__'":
            body = [ast.unparse(line) for line in statement.body]
            calls = body in (["main()"], ["sys.exit(main())"], ["raise SystemExit(main())"])
        elif not isinstance(
            statement, (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.ClassDef, ast.Assign, ast.AnnAssign)
        ) and not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)):
            return False  # a statement that may do anything, at import
    return defines and calls


def load_script(path):
    """Import a script without running its main program."""
    sys.path.insert(0, os.path.dirname(os.path.abspath(path)))
    spec = importlib.util.spec_from_file_location("mavfi_node_under_test", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def has_exited(pid):
    """Whether a process has ended, or its first thread has; it stays as a zombie until it is waited for."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


# ---- processes -------------------------------------------------------------------------------------------------------
class Launcher:
    """Starts processes on request.

    Args:
        connection: Socket of the requests.
        role: "driver", "node" or "plain".
        script: The script of a node; "" = none.
    """

    def __init__(self, connection, role, script):
        self._connection = connection
        self._script = script
        if script:
            self._script = os.path.abspath(script)
        self._main = None
        self._drive = None
        self._started = {}
        if role == "driver":
            import driver

            driver.import_ros()
            self._drive = driver.main
        elif role == "node" and is_forkable(script):
            import rclpy  # noqa: F401 - imported once, for all children

            module = load_script(script)
            self._main = module.main
            sys.modules["__main__"] = module

    def serve(self):
        """Meet requests until the socket is closed."""
        pending = b""
        while True:
            content, descriptors, _, _ = socket.recv_fds(self._connection, LARGEST_REQUEST, 1)
            if not content:
                self.do_end()
                return
            pending += content
            while b"\n" in pending:
                line, _, pending = pending.partition(b"\n")
                request = json.loads(line)
                action = getattr(self, "do_" + request.pop("do"))
                try:
                    reply = action(*descriptors, **request)
                except OSError as error:
                    reply = {"error": f"{error.filename or 'system'}: {error.strerror}"}
                for descriptor in descriptors:
                    os.close(descriptor)
                descriptors = []
                self._connection.sendall(json.dumps(reply).encode() + b"\n")

    def do_ready(self):
        """Say that all is imported, and whether the script is forked."""
        return {"forks": self._main is not None or self._drive is not None}

    def do_load(self, kinds):
        """Load the libraries of message types, once for all that is forked."""
        for kind in kinds:
            package, folder, name = kind.split("/")
            message_class = getattr(importlib.import_module(f"{package}.{folder}"), name)
            type(message_class).__import_type_support__()
        return {}

    def do_drive(self, descriptor):
        """Fork a driver, with namespaces of its own, that talks over the socket beside the request."""
        pid = os.fork()
        if pid == 0:
            self._in_child()
            unshare()
            self._drive(descriptor)
            os._exit(1)
        self._started[pid] = None
        return {"pid": pid}

    def do_start(self, command, namespace, log):
        """Start a program, in the namespaces of a process; that of the script is forked."""
        pid = os.fork()
        if pid == 0:
            self._in_child()
            self._become(command, namespace, log)
        self._started[pid] = None
        return {"pid": pid}

    def do_end(self):
        """End all processes that were started, and theirs; say how each ended (as `waitpid` does)."""
        for pid, status in list(self._started.items()):
            if status is None:
                # The first thread of a process that is ending may be gone before the others.
                options = os.WNOHANG
                if has_exited(pid):
                    options = 0
                ended, status = os.waitpid(pid, options)
                if ended:
                    self._started[pid] = status
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(pid, signal.SIGKILL)
        statuses = {pid: status for pid, status in self._started.items() if status is not None}
        # What they started has become a child of this process.
        while True:
            with open(f"/proc/self/task/{os.getpid()}/children") as file:
                children = [int(pid) for pid in file.read().split()]
            if not children:
                break
            for pid in children:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
        self._started = {}
        return {"statuses": statuses}

    def _in_child(self):
        """Be the leader of a process group that ends with this process's parent."""
        self._connection.close()
        os.setsid()
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)

    def _become(self, command, namespace, log):
        """Run the command in this process; returns never."""
        code = 127
        try:
            output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
            os.dup2(output, 1)
            os.dup2(output, 2)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            enter(namespace)
            if self._main is not None and os.path.abspath(command[1]) == self._script:
                sys.argv = command[1:]
                code = self._main() or 0
            else:
                try:
                    os.execvp(command[0], command)
                except OSError as error:
                    sys.stderr.write(f"{command[0]}: {error.strerror}\n")
        except SystemExit as error:
            code = error.code or 0
        except BaseException:  # noqa: BLE001 - as the interpreter does
            sys.excepthook(*sys.exc_info())
            code = 1
        if not isinstance(code, int):
            sys.stderr.write(f"{code}\n")
            code = 1
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code & 0xFF)


def main():
    """Serve one bench over an inherited socket."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    libc.prctl(PR_SET_CHILD_SUBREAPER, 1)
    connection = socket.socket(fileno=int(sys.argv[1]))
    script = ""
    if len(sys.argv) > 3:
        script = sys.argv[3]
    Launcher(connection, sys.argv[2], script).serve()


if __name__ == "__main__":
    main()
