"""viewer.py MODEL:IMAGES ... - opens index.html of the current folder in headless Chromium, has it draw survey's held-out views of each
model, and compares them with the PNG in IMAGES. Fails below 35 dB. The browser is controlled by its DevTools protocol over a websocket."""
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
        for model, drawn in (a.split(':') for a in sys.argv[1:]):
            browser.evaluate(f'viewer.open({json.dumps(model)})')
            for name, camera in cameras():
                coded = browser.evaluate('(() => { const p = viewer.draw(%s); let s = ""; for (let i = 0; i < p.length; i += 4) '
                                         's += String.fromCharCode(p[i], p[i + 1], p[i + 2]); return btoa(s); })()' % json.dumps(camera))
                seen = base64.b64decode(coded)
                width, height, wanted = read_png(f'{drawn}/{name}.png')
                write_png(f'{drawn}/{name}.viewer.png', width, height, seen)
                psnr = decibel(seen, wanted)
                worst = min(worst, psnr)
                print(f'{psnr:6.2f} dB  {model}  {name}')
        # With the lobes off, a model that has them must look different: else the switch does nothing.
        browser.evaluate(f'viewer.open({json.dumps(sys.argv[1].split(":")[0])})')
        same = browser.evaluate('(() => { const c = %s, a = viewer.draw(c); viewer.lobes(false); const b = viewer.draw(c); '
                                'return a.every((x, i) => x === b[i]); })()' % json.dumps(cameras()[0][1]))
    finally:
        browser.close()
        server.shutdown()
    if same:
        raise SystemExit('viewer: the switch for lobes changes nothing')
    if worst < LIMIT:
        raise SystemExit(f'viewer: {worst:.2f} dB, wanted {LIMIT}')


if __name__ == '__main__':
    main()
