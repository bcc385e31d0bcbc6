"""clients_viewer.py PLAYCANVAS FOLDER ASSET=MODEL:LIMIT ... - the PlayCanvas engine (folder of playcanvas.mjs) draws ASSET in headless Chromium
at survey's held-out views, in the folder FOLDER; its mean PSNR against the images is within LIMIT dB of `oceanxl eval MODEL`, from OCEANXL."""
import base64, json, os, subprocess, sys, threading, http.server

import viewer

PAGE = '''<!doctype html><canvas id="c"></canvas><script type="module">
import * as pc from './playcanvas.mjs';
const canvas = document.getElementById('c');
const app = new pc.Application(canvas, {graphicsDeviceOptions: {antialias: false, preserveDrawingBuffer: true}});
app.graphicsDevice.maxPixelRatio = 1;
app.start();
const eye = new pc.Entity(), holder = new pc.Entity();
eye.addComponent('camera', {clearColor: new pc.Color(0, 0, 0), nearClip: 0.01, farClip: 1000, toneMapping: pc.TONEMAP_NONE,
    gammaCorrection: pc.GAMMA_SRGB});
app.root.addChild(eye);
app.root.addChild(holder);
const frames = async n => { for (let i = 0; i < n; i++) await new Promise(done => requestAnimationFrame(done)); };
window.load = (url, streamed) => new Promise((done, fail) => {
    const asset = new pc.Asset(url, 'gsplat', {url});
    asset.on('error', e => fail(String(e)));
    asset.on('load', () => {
        if (holder.gsplat) holder.removeComponent('gsplat');
        holder.addComponent('gsplat', {asset, unified: streamed});
        done(1);
    });
    app.assets.add(asset);
    app.assets.load(asset);
});
// The engine leaves out splats whose centre is outside of the image and cuts large ones: the middle of an image of three times the sides.
window.draw = async c => {
    app.setCanvasResolution(pc.RESOLUTION_FIXED, 9 * c.width, 9 * c.height);
    eye.camera.calculateProjection = m => {
        m.setPerspective(2 * Math.atan(9 * c.height / 2 / c.fy) * 180 / Math.PI, c.width * c.fy / c.height / c.fx, 0.01, 1000);
        m.data[8] = (c.width - 2 * c.cx) / 9 / c.width;  // the principal point
        m.data[9] = (2 * c.cy - c.height) / 9 / c.height;
    };
    eye.setPosition(...c.position);
    eye.setRotation(...c.rotation);
    await frames(60);
    const flat = document.createElement('canvas');
    [flat.width, flat.height] = [c.width, c.height];
    const to = flat.getContext('2d');
    to.drawImage(canvas, -4 * c.width, -4 * c.height);
    let s = '';
    const p = to.getImageData(0, 0, c.width, c.height).data;
    for (let i = 0; i < p.length; i += 4) s += String.fromCharCode(p[i], p[i + 1], p[i + 2]);
    return btoa(s);
};
window.ready = 1;
</script>'''


def pose(camera, origin):
    """Camera to world, in the model's coordinates; PlayCanvas looks along -z with y up: half a turn about x."""
    w, x, y, z = camera['quaternion']
    r = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
         [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    t = camera['translation']
    place = [-sum(r[k][i] * t[k] for k in range(3)) - origin[i] for i in range(3)]
    return dict({k: camera[k] for k in ('width', 'height', 'fx', 'fy', 'cx', 'cy')}, position=place,
                rotation=[w, -z, y, x])  # x y z w of conj(q) (0 1 0 0)


def main():
    playcanvas, folder = os.path.abspath(sys.argv[1]), sys.argv[2]
    os.chdir(folder)
    open('page.html', 'w').write(PAGE)
    if not os.path.exists('playcanvas.mjs'):
        os.symlink(playcanvas + '/playcanvas.mjs', 'playcanvas.mjs')
    viewer.Quiet.extensions_map = {**viewer.Quiet.extensions_map, '.mjs': 'text/javascript'}
    server = http.server.ThreadingHTTPServer(('127.0.0.1', 0), viewer.Quiet)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    browser, failed = viewer.Browser(), 0
    try:
        for job in sys.argv[3:]:
            asset, rest = job.split('=')
            model, limit = rest.split(':')
            info = json.loads(subprocess.run([os.environ['OCEANXL'], 'info', model, '--json'], capture_output=True).stdout)
            wanted = json.loads(subprocess.run([os.environ['OCEANXL'], 'eval', model, 'survey', '--json'], capture_output=True).stdout)['psnr']
            browser.call('Page.navigate', url=f'http://127.0.0.1:{server.server_port}/page.html')
            browser.wait(lambda: browser.evaluate('window.ready'))
            browser.evaluate('load(%s, %s)' % (json.dumps(asset), json.dumps(asset.endswith('lod-meta.json'))))
            sums = []
            for name, camera in viewer.cameras():
                seen = base64.b64decode(browser.evaluate('draw(%s)' % json.dumps(pose(camera, info['origin']))))
                width, height, image = viewer.read_png('survey/images/' + name)
                viewer.write_png(asset.replace('/', '_') + '.' + name, width, height, seen)
                sums.append(viewer.decibel(seen, image))
            psnr = sum(sums) / len(sums)
            bad = not abs(psnr - wanted) <= float(limit)
            failed += bad
            print('FAIL' if bad else 'ok  ', f'PlayCanvas draws {asset}: {psnr:.2f} dB, oceanxl eval {wanted:.2f}, wanted within {limit}')
    finally:
        browser.close()
        server.shutdown()
    sys.exit(failed > 0)


main()
