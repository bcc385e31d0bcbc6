"""viewer.py MODEL:IMAGES[:LIMIT] ... - opens index.html of the current folder in headless Chromium, has it draw survey's held-out views of
each model, and compares them with the PNG in IMAGES. Fails below LIMIT, 35 dB. Of the last, whose IMAGES have depths, the places that pixels
show must be as deep, and the first picture is that of a camera of the survey. The browser is controlled by its DevTools protocol over a websocket."""
import base64, http.server, json, math, os, re, shutil, socket, struct, subprocess, sys, tempfile, threading, time, urllib.request, zlib

LIMIT = 35.0


def read_png(path):
    """8-bit RGB, as the program writes it: (width, height, bytes)."""
    data, at, packed = open(path, 'rb').read(), 8, b''
    while at < len(data):
        size, kind = struct.unpack('>I4s', data[at:at + 8])
        body = data[at + 8:at + 8 + size]
        if kind == b'IHDR':
            width, height = struct.unpack('>II', body[:8])
        if kind == b'IDAT':
            packed += body
        at += 12 + size
    raw, stride, out, before = zlib.decompress(packed), 3 * width, bytearray(), bytearray(3 * width)
    for y in range(height):
        kind, row = raw[y * (stride + 1)], bytearray(raw[y * (stride + 1) + 1:(y + 1) * (stride + 1)])
        for i in range(stride):
            a, b, c = row[i - 3] if i >= 3 else 0, before[i], before[i - 3] if i >= 3 else 0
            p = a + b - c
            paeth = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            row[i] = (row[i] + (0, a, b, (a + b) // 2, paeth)[kind]) & 255
        out += row
        before = row
    return width, height, bytes(out)


def write_png(path, width, height, rgb):
    rows = b''.join(b'\0' + rgb[3 * width * y:3 * width * (y + 1)] for y in range(height))
    with open(path, 'wb') as f:
        f.write(b'\x89PNG\r\n\x1a\n')
        for kind, body in ((b'IHDR', struct.pack('>IIBBBBB', width, height, 8, 2, 0, 0, 0)), (b'IDAT', zlib.compress(rows)), (b'IEND', b'')):
            f.write(struct.pack('>I', len(body)) + kind + body + struct.pack('>I', zlib.crc32(kind + body)))


class Browser:
    """One page of a Chromium of its own."""

    def __init__(self):
        self.profile = tempfile.mkdtemp()
        name = next(n for n in ('chromium', 'chromium-browser', 'google-chrome') if shutil.which(n))
        self.process = subprocess.Popen([name, '--headless', '--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader',
                                         '--remote-debugging-port=0', f'--user-data-dir={self.profile}', 'about:blank'],
                                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port = self.wait(lambda: int(open(self.profile + '/DevToolsActivePort').readline()))
        pages = self.wait(lambda: [p for p in json.load(urllib.request.urlopen(f'http://127.0.0.1:{port}/json')) if p['type'] == 'page'])
        address = re.match(r'ws://[^/]+(/.*)', pages[0]['webSocketDebuggerUrl']).group(1)
        self.socket, self.number = socket.create_connection(('127.0.0.1', port)), 0
        self.socket.sendall((f'GET {address} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n'
                             f'Sec-WebSocket-Key: {base64.b64encode(os.urandom(16)).decode()}\r\nSec-WebSocket-Version: 13\r\n\r\n').encode())
        self.stream = self.socket.makefile('rb')
        while self.stream.readline() != b'\r\n':
            pass

    @staticmethod
    def wait(attempt):
        for _ in range(300):
            try:
                found = attempt()
                if found:
                    return found
            except (OSError, ValueError):
                pass
            time.sleep(0.2)
        raise SystemExit('viewer: the browser did not come up')

    def receive(self):
        message, last = b'', 0
        while not last:
            head = self.stream.read(2)
            last, size = head[0] >> 7, head[1] & 127
            if size > 125:
                size = int.from_bytes(self.stream.read(2 if size == 126 else 8), 'big')
            message += self.stream.read(size)
        return json.loads(message)

    def call(self, method, **parameters):
        self.number += 1
        body, mask = json.dumps({'id': self.number, 'method': method, 'params': parameters}).encode(), os.urandom(4)
        head = bytes([129, 254]) + struct.pack('>H', len(body)) if 125 < len(body) < 65536 else bytes([129, 128 | len(body)])
        self.socket.sendall(head + mask + bytes(b ^ mask[i % 4] for i, b in enumerate(body)))
        while True:
            answer = self.receive()
            if answer.get('id') == self.number:
                return answer['result']

    def evaluate(self, script):
        answer = self.call('Runtime.evaluate', expression=script, awaitPromise=True, returnByValue=True)
        if 'exceptionDetails' in answer:
            raise SystemExit('viewer: ' + json.dumps(answer['exceptionDetails'])[:600])
        return answer['result'].get('value')

    def close(self):
        self.process.terminate()
        self.process.wait()
        shutil.rmtree(self.profile, ignore_errors=True)


def cameras():
    """Of the held-out views, every 8th by name."""
    lines = [l for l in open('survey/sparse/0/images.txt') if not l.startswith('#')][::2]
    line = next(l for l in open('survey/sparse/0/cameras.txt') if not l.startswith('#')).split()
    lens = dict(width=int(line[2]), height=int(line[3]), fx=float(line[4]), fy=float(line[5]), cx=float(line[6]), cy=float(line[7]))
    views = sorted((l.split()[9], l.split()) for l in lines)[::8]
    return [(name, dict(lens, quaternion=[float(x) for x in w[1:5]], translation=[float(x) for x in w[5:8]])) for name, w in views]


def decibel(a, b):
    error = sum((x - y) ** 2 for x, y in zip(a, b)) / len(a)
    return 99.0 if error == 0 else 10 * math.log10(255 ** 2 / error)


def read_depth(path):
    """Rows from the top, floats."""
    with open(path, 'rb') as f:
        f.readline()
        width, height = map(int, f.readline().split())
        f.readline()
        rows = [struct.unpack(f'<{width}f', f.read(4 * width)) for _ in range(height)]
    return rows[::-1]


def rotate(q, p):
    w, x, y, z = q
    return [(1 - 2 * (y * y + z * z)) * p[0] + 2 * (x * y - w * z) * p[1] + 2 * (x * z + w * y) * p[2],
            2 * (x * y + w * z) * p[0] + (1 - 2 * (x * x + z * z)) * p[1] + 2 * (y * z - w * x) * p[2],
            2 * (x * z - w * y) * p[0] + 2 * (y * z + w * x) * p[1] + (1 - 2 * (x * x + y * y)) * p[2]]


def check_places(browser, drawn):
    """What viewer.pick finds is in its pixel, and as deep as the program's depth, in the median within 1 %."""
    errors = []
    for name, camera in cameras():
        depth = read_depth(f'{drawn}/{name}.depth.pfm')
        browser.evaluate(f'viewer.draw({json.dumps(camera)})')
        for x in range(8, camera['width'], 24):
            for y in range(8, camera['height'], 24):
                at = browser.evaluate(f'viewer.pick({x + 0.5}, {y + 0.5})')
                if at is None or not depth[y][x] > 0:
                    continue
                p = [a + b for a, b in zip(rotate(camera['quaternion'], at), camera['translation'])]
                off = math.hypot(camera['fx'] * p[0] / p[2] + camera['cx'] - x - 0.5, camera['fy'] * p[1] / p[2] + camera['cy'] - y - 0.5)
                if off > 0.1:
                    raise SystemExit(f'viewer: pick is {off:.2f} px beside its pixel')
                errors.append(abs(p[2] - depth[y][x]) / depth[y][x])
    errors.sort()
    print(f'places: {len(errors)}, depth differs by {100 * errors[len(errors) // 2]:.2f} % in the median')
    if len(errors) < 50 or errors[len(errors) // 2] > 0.01:
        raise SystemExit('viewer: places are at another depth than that of the program')


def check_measuring(browser):
    """Two clicks in the page, as a user makes them, give a length."""
    browser.evaluate('document.getElementById("measure").click()')
    for x, y in ((300, 250), (420, 300)):
        for kind in ('mousePressed', 'mouseReleased'):
            browser.call('Input.dispatchMouseEvent', type=kind, x=x, y=y, button='left', clickCount=1)
    browser.evaluate('new Promise(done => setTimeout(done, 500))')
    text = browser.evaluate('document.getElementById("facts").textContent')
    print('measured:', text)
    if not re.match(r'[0-9.]+ units$', text) or not browser.evaluate('!!document.querySelector("#tape line")'):
        raise SystemExit(f'viewer: two clicks say {text!r}')


def check_start(browser, model):
    """The first camera is where the model's comment `view` says, and looks there."""
    view = next(l for l in open(model, 'rb').read(2000).decode('latin1').splitlines() if l.startswith('comment view')).split()[2:]
    view = [float(x) for x in view]
    browser.evaluate(f'viewer.open({json.dumps(model)})')
    c = browser.evaluate('viewer.camera()')
    origin = next(l for l in open(model, 'rb').read(2000).decode('latin1').splitlines() if l.startswith('comment origin')).split()[2:]
    r, t = c['rotation'], c['translation']
    eye = [-sum(r[3 * i + k] * t[i] for i in range(3)) + float(origin[k]) for k in range(3)]
    apart = math.dist(eye, view[10:])
    angle = math.degrees(math.acos(min(1, sum(a * b for a, b in zip(r[6:], view[7:10])))))
    turned = math.degrees(math.acos(min(1, sum(a * b for a, b in zip(r[:3], view[1:4])))))
    print(f'start: {apart:.4f} units from the camera, turned by {angle:.1f} degrees, about its axis by {turned:.1f}')
    if apart > 0.01 or angle > 3 or turned > 10:
        raise SystemExit('viewer: it does not begin at the camera')


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


def main():
    server = http.server.ThreadingHTTPServer(('127.0.0.1', 0), Quiet)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address, browser, worst = f'http://127.0.0.1:{server.server_port}/', Browser(), 99.0
    try:
        browser.call('Page.navigate', url=address + 'index.html')
        browser.wait(lambda: browser.evaluate('document.readyState === "complete" && !!window.viewer'))
        for model, drawn, limit in ((a.split(':') + [str(LIMIT)])[:3] for a in sys.argv[1:]):
            browser.evaluate(f'viewer.open({json.dumps(model)})')
            for name, camera in cameras():
                coded = browser.evaluate('(() => { const p = viewer.draw(%s); let s = ""; for (let i = 0; i < p.length; i += 4) '
                                         's += String.fromCharCode(p[i], p[i + 1], p[i + 2]); return btoa(s); })()' % json.dumps(camera))
                seen = base64.b64decode(coded)
                width, height, wanted = read_png(f'{drawn}/{name}.png')
                write_png(f'{drawn}/{name}.viewer.png', width, height, seen)
                psnr = decibel(seen, wanted)
                worst = min(worst, psnr - float(limit))
                print(f'{psnr:6.2f} dB  {model}  {name}')
        check_places(browser, drawn)
        check_start(browser, model)
        check_measuring(browser)
        # With the lobes off, a model that has them must look different: else the switch does nothing.
        browser.evaluate(f'viewer.open({json.dumps(sys.argv[1].split(":")[0])})')
        same = browser.evaluate('(() => { const c = %s, a = viewer.draw(c); viewer.lobes(false); const b = viewer.draw(c); '
                                'return a.every((x, i) => x === b[i]); })()' % json.dumps(cameras()[0][1]))
    finally:
        browser.close()
        server.shutdown()
    if same:
        raise SystemExit('viewer: the switch for lobes changes nothing')
    if worst < 0:
        raise SystemExit(f'viewer: {-worst:.2f} dB less than wanted')


if __name__ == '__main__':
    main()
