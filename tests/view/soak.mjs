// By hand: memory of the page and of trocar-view while the figure 8 goes on, minute by minute; fails where it grows. In a
// private network:
//   scripts/netns node tests/view/soak.mjs BUILD_DIR SOURCE_DIR [MINUTES]
import { readFileSync } from 'node:fs'
import { launch, run, ready, scene } from './parts.mjs'

const FULL = 2        // minutes until the last minute's history is full
const GROWTH = 1.1    // that counts as none
const minutes = Number(process.argv[4] ?? 10)

/** Resident memory in MB. */
const resident = (child) => Number(/VmRSS:\s*(\d+)/.exec(readFileSync(`/proc/${child.pid}/status`, 'utf8'))[1]) / 1000

const server = run('server/trocar-server', '--scene', scene, '--allow-non-rt'), view = run('view/trocar-view', '--scene', scene)
await Promise.all([ready(server), ready(view)])
const device = run('clients/trocar-device', '--script', 'figure8', '--duration', String(60 * minutes + 20))
const browser = await launch('--js-flags=--expose-gc', '--enable-precise-memory-info'), page = await browser.newPage({ viewport: { width: 1000, height: 640 } })
await page.goto('http://127.0.0.1:8686/')

const seen = []
for (let minute = 1; minute <= minutes; minute++) {
  await new Promise((done) => setTimeout(done, 60000))
  const { heap, pictures, shapes } = await page.evaluate(() => {
    gc()
    return { heap: performance.memory.usedJSHeapSize / 1e6, pictures: trocar.history.pictures.length, shapes: trocar.stage.renderer.info.memory.geometries }
  })
  seen.push({ heap, view: resident(view) })
  console.log(`minute ${minute}: page ${heap.toFixed(1)} MB, ${pictures} pictures, ${shapes} shapes; trocar-view ${resident(view).toFixed(1)} MB`)
}
await browser.close()
for (const child of [device, view, server]) child.kill()
const grows = ['heap', 'view'].filter((name) => seen.length > FULL && seen.at(-1)[name] > GROWTH * seen[FULL - 1][name])
console.log(grows.length ? `FAILED: ${grows} grows` : 'no growth')
process.exit(grows.length)
