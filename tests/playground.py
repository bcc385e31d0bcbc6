"""playground.py CHROMIUM FOLDER - serves FOLDER, lets the page train its survey, and compares the model that it posts with native/scene.ply."""
import http.server
import pathlib
import subprocess
import sys
import threading
import urllib.parse

chromium, folder = sys.argv[1], pathlib.Path(sys.argv[2])
posted, came = [], threading.Event()


class Handler(http.server.SimpleHTTPRequestHandler):
    def __init__(self, *arguments):
        super().__init__(*arguments, directory=str(folder))

    def do_POST(self):
        posted.append((urllib.parse.parse_qs(urllib.parse.urlparse(self.path).query), self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()
        came.set()

    def log_message(self, *_):
        pass


server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
threading.Thread(target=server.serve_forever, daemon=True).start()
address = f"http://127.0.0.1:{server.server_address[1]}/index.html?survey=survey/files.txt&steps=300&side=640&post=/model"
browser = subprocess.Popen([chromium, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder}/profile",
                            "--remote-debugging-port=0", address], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
came.wait(500)
browser.terminate()
browser.wait()
assert posted, "playground: the page posted no model"
query, model = posted[0]
native = (folder / "native" / "scene.ply").read_bytes()
print(f"playground: {query['seconds'][0]} s, held-out views {query['psnr'][0]} dB, {len(model)} bytes")
if model != native:
    (folder / "page.ply").write_bytes(model)
    sys.exit(f"playground: the page's scene.ply differs from the native one ({len(model)} and {len(native)} bytes): {model[:300]!r}")
print("1 passed, 0 failed")
