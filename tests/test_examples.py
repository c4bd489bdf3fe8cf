"""The programs of docs/examples, built and run beside ``depthcli predict``."""

import queue
import shutil
import subprocess
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
import pytest
from helpers.command_line import Cli

import depthcli

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "docs" / "examples"
MODELS = ROOT / "models"
ROOM = ROOT / "docs" / "room.jpg"


def check_depth(depth_m: np.ndarray, inside: Cli, image: Path, model: str, hfov: str) -> None:
    """Compare with ``predict``; rounding of int8 differs between runtimes, and between options."""
    words = ("-o", "depth.npy", "--upsample", "bilinear", "--model", MODELS / model)
    inside("predict", image, *words, *(["--hfov", hfov] if hfov else []), code=0)
    apart_m = np.abs(depth_m - np.load(inside.folder / "depth.npy"))
    assert apart_m.max() <= 0.002 if model == "float" else (apart_m / depth_m).mean() <= 0.01


BROWSER = shutil.which("chromium")
RUNTIME = EXAMPLES / "browser" / "node_modules"
DRIVER = """<iframe src="index.html"></iframe><script>
onload = async () => {
  const page = document.querySelector("iframe").contentWindow;
  const $ = (id) => page.document.getElementById(id);
  const until = async (isTrue) => {
    while (!isTrue()) await new Promise((done) => setTimeout(done, 50));
  };
  await until(() => /ready/.test($("status").textContent));
  const chosen = new DataTransfer();
  chosen.items.add(new File([await (await fetch("image")).blob()], "room"));
  $("hfov").value = "@hfov@";
  $("file").files = chosen.files;
  $("file").dispatchEvent(new Event("change"));
  await until(() => $("save").href);
  const post = (body) => fetch("depth", { method: "POST", body });
  await post(await (await fetch($("save").href)).blob());
  const box = $("depth").getBoundingClientRect();
  const middle = { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 };
  $("depth").dispatchEvent(new page.PointerEvent("pointermove", middle));
  await post($("status").textContent);
};
</script>"""


class Pages(SimpleHTTPRequestHandler):
    """Serves a folder, and keeps what is posted."""

    posted: queue.Queue[bytes] = queue.Queue()

    def log_message(self, *_: object) -> None:
        pass

    def do_POST(self) -> None:
        self.posted.put(self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(204)
        self.end_headers()


@pytest.mark.skipif(BROWSER is None, reason="no chromium on this machine")
@pytest.mark.skipif(not RUNTIME.is_dir(), reason="no `npm install` in docs/examples/browser")
@pytest.mark.parametrize(
    ("model", "rows", "columns", "hfov"),
    [
        ("float", 480, 640, ""),
        ("float", 480, 301, "55"),
        ("float", 100, 150, "80"),
        ("default", 480, 640, ""),
    ],
    ids=["JPEG", "upright", "smaller than the network", "int8"],
)
def test_the_browser_shows_the_metres_of_predict(
    model: str, rows: int, columns: int, hfov: str, inside: Cli, tmp_path: Path
) -> None:
    image = tmp_path / "image"
    png = cv2.imencode(".png", cv2.imread(str(ROOM))[-rows:, :columns])[1].tobytes()
    image.write_bytes(ROOM.read_bytes() if rows * columns == 480 * 640 else png)
    for source in (*(EXAMPLES / "browser").glob("[id]*.*"), RUNTIME):
        (tmp_path / source.name).symlink_to(source)
    (tmp_path / "model").symlink_to(MODELS / model)
    (tmp_path / "driver.html").write_text(DRIVER.replace("@hfov@", hfov))
    handler = partial(Pages, directory=tmp_path)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        quiet = ("--disable-background-networking", "--disable-component-update", "--disable-sync")
        command = (str(BROWSER), "--headless", "--no-sandbox", "--no-first-run", *quiet)
        page = f"http://127.0.0.1:{server.server_port}/driver.html"
        options = ("--remote-debugging-port=0", f"--user-data-dir={tmp_path / 'browser'}")
        browser = subprocess.Popen((*command, *options, page), stderr=subprocess.DEVNULL)
        try:
            (tmp_path / "depth.pfm").write_bytes(Pages.posted.get(timeout=120))
            at_pointer = Pages.posted.get(timeout=60).decode()
        finally:
            browser.terminate()
            browser.wait(timeout=60)
            server.shutdown()
    shown_m = depthcli.read_depth(tmp_path / "depth.pfm").values
    x, y = map(int, at_pointer.partition("pixel")[2].split(","))
    assert at_pointer == f"{shown_m[y, x]:.3f} m at pixel {x}, {y}"
    check_depth(shown_m, inside, image, model, hfov)


COMPILER = ("g++", "-std=c++17", "-Wall", "-Werror", "-I/usr/include/onnxruntime")
LIBRARY = next(Path(onnxruntime.__file__).parent.glob("capi/libonnxruntime.so.*"), None)


HEADER = ("-E", "-include", "onnxruntime_cxx_api.h", "-x", "c++", "/dev/null")
HAS_HEADER = (
    shutil.which("g++")
    and not subprocess.run([*COMPILER, *HEADER], capture_output=True, check=False).returncode
)


@pytest.mark.skipif(not (LIBRARY and HAS_HEADER), reason="no g++, or no libonnxruntime-dev")
@pytest.mark.parametrize(("model", "hfov"), [("float", ""), ("float", "80"), ("default", "")])
def test_cpp_writes_the_millimetres_of_predict(
    model: str, hfov: str, inside: Cli, tmp_path: Path
) -> None:
    for name in ("libonnxruntime.so", "libonnxruntime.so.1"):
        (tmp_path / name).symlink_to(LIBRARY)
    linked = (f"-L{tmp_path}", f"-Wl,-rpath,{tmp_path}", "-lonnxruntime")
    source = EXAMPLES / "cpp" / "depth.cpp"
    subprocess.run([*COMPILER, source, "-o", tmp_path / "depth", *linked], check=True)
    image, target = tmp_path / "room.ppm", tmp_path / "room.pgm"
    cv2.imwrite(str(image), cv2.imread(str(ROOM))[60:, :500])
    words = (tmp_path / "depth", MODELS / model, image, target)
    subprocess.run([*words, *filter(None, [hfov])], check=True)
    check_depth(cv2.imread(str(target), -1) / 1000, inside, image, model, hfov)
    image.write_bytes(image.read_bytes()[:999])
    cut = subprocess.run(words, capture_output=True, check=False, text=True)
    assert (cut.returncode, cut.stderr) == (1, f"{image} is cut off\n")
