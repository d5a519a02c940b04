/* Measures the memory of the page, of Chromium and of trocar-view every minute while the figure 8 is repeated with the tissue cut open; fails if the memory
   grows. Run by hand, in a private network, so that no other Chromium is counted:
   scripts/netns node tests/view/soak.mjs BUILD_DIR SOURCE_DIR [MINUTES] */
import { readdirSync, readFileSync } from 'node:fs'
import { ADDRESS, launch, run, start, stop } from './parts.mjs'

const FULL = 2        // minutes after which the one-minute history is certainly full
const GROWTH = 1.1    // tolerated ratio of the second half's median to the first half's
const minutes = Number(process.argv[4] ?? 10)

/** Returns a process's private memory plus its proportional share of shared memory, in MB, without file mappings. */
function resident(id) {
  try {
    const held = readFileSync(`/proc/${id}/smaps_rollup`, 'latin1')
    return ['Pss_Anon', 'Pss_Shmem'].reduce((sum, name) => sum + Number(new RegExp(`^${name}:\\s*(\\d+)`, 'm').exec(held)[1]) / 1000, 0)
  } catch { return 0 /* the process has ended */ }
}

function isChromium(id) {
  try {
    return /chromium/.test(readFileSync(`/proc/${id}/cmdline`, 'latin1'))
  } catch { return false }
}

/** Returns the memory of all Chromium processes. Only those of this run are visible, because a private network also has its own process ids. */
const residentOfChromium = () => readdirSync('/proc').filter((id) => /^\d+$/.test(id) && isChromium(id)).reduce((sum, id) => sum + resident(id), 0)

function grows(name) {
  const values = seen.slice(FULL - 1).map((minute) => minute[name]), half = values.length >> 1
  const median = (some) => some.sort((a, b) => a - b)[some.length >> 1]
  return half > 0 && median(values.slice(-half)) > GROWTH * median(values.slice(0, half))
}

const server = await start('server/trocar-server', '--allow-non-rt'), view = await start('clients/view/trocar-view')
const device = run('clients/trocar-device', '--script', 'figure8', '--duration', String(60 * minutes + 20))
const browser = await launch(), page = await browser.newPage({ viewport: { width: 1000, height: 640 } }), inspector = await page.context().newCDPSession(page)
await page.goto(ADDRESS)
await page.selectOption('#cut-axis', 'x')

const seen = []
for (let minute = 1; minute <= minutes; minute++) {
  await new Promise((done) => setTimeout(done, 60000))
  await inspector.send('HeapProfiler.collectGarbage')
  const heap = (await inspector.send('Runtime.getHeapUsage')).usedSize / 1e6
  const { pictures, marks, shapes } = await page.evaluate('({ pictures: trocar.history.pictures.length, marks: trocar.history.marks.length, shapes: trocar.stage.renderer.info.memory.geometries })')
  seen.push({ heap, chromium: residentOfChromium(), view: resident(view.pid) })
  console.log(`minute ${minute}: page ${heap.toFixed(1)} MB (${pictures} pictures, ${marks} marks, ${shapes} shapes), Chromium ${seen.at(-1).chromium.toFixed(0)} MB, trocar-view ${seen.at(-1).view.toFixed(1)} MB`)
}
await browser.close()
for (const child of [device, view, server]) await stop(child)
const growing = Object.keys(seen[0]).filter(grows)
console.log(growing.length ? `FAILED: ${growing} grows` : 'no growth')
process.exit(growing.length)
