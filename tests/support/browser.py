"""Chromium without a window, driven over pipes by its DevTools protocol: no port, no other package."""

import base64
import fcntl
import itertools
import json
import os
import shutil
import subprocess
import time

FLAGS = (
    "--headless --no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-component-update "
    "--disable-sync --use-angle=swiftshader --enable-unsafe-swiftshader --remote-debugging-pipe --window-size=1200,800 "
    "--disable-gpu-watchdog --disable-domain-blocking-for-3d-apis"  # a busy machine draws late: that is no hung GPU
).split()


class Browser:
    """A context manager; `errors` holds what the console complained of."""

    def __init__(self, folder):
        self.folder, self.errors, self.ids, self.session = folder, [], itertools.count(1), None

    def __enter__(self):
        ours, theirs = os.pipe(), os.pipe()  # it reads its 3 and writes its 4
        ends = [fcntl.fcntl(fd, fcntl.F_DUPFD, 10) for fd in (ours[0], theirs[1])]

        def wire():
            for place, end in zip((3, 4), ends):
                os.dup2(end, place)

        command = [shutil.which("chromium"), *FLAGS, f"--user-data-dir={self.folder}", "about:blank"]
        silent = dict(stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        self.process = subprocess.Popen(command, preexec_fn=wire, close_fds=False, **silent)
        for fd in (ours[0], theirs[1], *ends):
            os.close(fd)
        self.write, self.read, self.rest = os.fdopen(ours[1], "wb", 0), theirs[0], b""
        target = self.ask("Target.getTargets")["targetInfos"][0]["targetId"]
        self.session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.write.close()
        os.close(self.read)

    def ask(self, method, **parameters):
        """The answer to one command."""
        number = next(self.ids)
        message = {"id": number, "method": method, "params": parameters}
        message |= {"sessionId": self.session} if self.session else {}
        self.write.write(json.dumps(message).encode() + b"\0")
        while True:
            answer = self.message()
            if answer.get("id") == number:
                assert "error" not in answer, answer["error"]
                return answer["result"]

    def message(self):
        while b"\0" not in self.rest:
            data = os.read(self.read, 1 << 16)
            assert data, "chromium ended"
            self.rest += data
        line, self.rest = self.rest.split(b"\0", 1)
        found = json.loads(line)
        method, said = found.get("method"), found.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(said["exceptionDetails"].get("exception", {}).get("description", str(said)))
        if method == "Runtime.consoleAPICalled" and said["type"] in ("error", "warning"):
            self.errors.append(str([a.get("value", a.get("description")) for a in said["args"]]))
        if method == "Log.entryAdded" and said["entry"]["level"] == "error":
            self.errors.append(f"{said['entry']['text']} {said['entry'].get('url', '')}")
        return found

    def open(self, address, ready, seconds=300):
        """Goes to a page and waits until the expression `ready` holds."""
        self.ask("Page.navigate", url=address)
        end = time.monotonic() + seconds
        while not self.run(f"Boolean({ready})"):
            assert time.monotonic() < end, f"{address}: not ready; {self.errors}"
            time.sleep(0.1)

    def run(self, script):
        """The value of an expression, awaited."""
        found = self.ask("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def picture(self, path):
        path.write_bytes(base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"]))
