/* Measures how many computed ultrasound images per second a browser shows without a graphics card while a needle moves in the pelvis, how long computing takes, how old the
   picture in the 3D view is, and how much processor time each program uses meanwhile. Run by hand, in a private network:
   scripts/netns node tests/view/measure_ultrasound.mjs BUILD_DIR SOURCE_DIR [SECONDS] [PICTURE] */
import { readdirSync, readFileSync } from 'node:fs'
import path from 'node:path'
import { ADDRESS, launch, source, start, stop } from './parts.mjs'

const [seconds = '20', picture] = process.argv.slice(4), pelvis = path.join(source, 'meshes/pelvis.yaml'), HERTZ = 100 // clock ticks per second in /proc
const quantile = (values, q) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(q * values.length))]
const view = await start('clients/view/trocar-view', '--scene', pelvis), server = await start('server/trocar-server', '--allow-non-rt', '--scene', pelvis), browser = await launch()
const page = await (await browser.newContext({ viewport: { width: 1280, height: 800 } })).newPage()
const wait = async (expression, again = () => {}) => { while (!await page.evaluate(`'trocar' in window && (${expression})`)) { await again(); await page.waitForTimeout(50) } }
const take = async () => { if (!await page.evaluate('trocar.status.drives')) await page.click('#take') } // on a busy machine, the needle may have been released

/** Returns the CPU time (s: user, system) and the page faults of all processes so far, by kind. */
function usage() {
  const found = {}
  for (const pid of readdirSync('/proc').filter((name) => /^\d+$/.test(name))) {
    try {
      const words = readFileSync(`/proc/${pid}/cmdline`, 'latin1').split(/[\0 ]/), stat = readFileSync(`/proc/${pid}/stat`, 'latin1').replace(/^.*\) /, '').split(' ')
      const name = path.basename(words[0]), kind = words.find((word) => word.startsWith('--type='))?.slice(7) ?? (/chromium/.test(name) ? 'browser' : name)
      const sum = (found[kind] ??= { user: 0, system: 0, faults: 0 })
      sum.user += Number(stat[11]) / HERTZ
      sum.system += Number(stat[12]) / HERTZ
      sum.faults += Number(stat[7])
    } catch { /* the process has ended */ }
  }
  return found
}

await page.goto(ADDRESS)
await wait('window.trocar?.state.name === "live" && trocar.echo.simulated')
await page.evaluate('trocar.procedure.choose(trocar.procedure.template.find("E3.5"))')
await wait('trocar.status.drives && trocar.procedure.template.aside(trocar.stage.needles[0].tip, trocar.procedure.hole).length() < 5e-4', take)
await page.evaluate(() => {
  window.got = { pictures: [], took: [] }
  for (const [name, list] of [['picture', 'pictures'], ['ultrasound', 'took']]) {
    const take = trocar.scanner.link.handlers[name]
    trocar.scanner.link.handlers[name] = (content) => { got[list].push(name === 'picture' ? performance.now() : content[0].milliseconds); take(content) }
  }
  const { drive } = trocar
  drive.command = () => { // moves the needle back and forth without a pause
    const { z } = trocar.stage.needles[0].tip
    window.back = z > 0.05 || window.back && z > 0.03
    return [0, 0, drive.steering ? (window.back ? -0.3 : 0.3) : 0, 0, 0, 0]
  }
})
await wait('trocar.stage.needles[0].tip.z > 0.03', take)
await page.evaluate('for (const slice of [trocar.echo, trocar.procedure.sagittal]) slice.frames.length = 0; got.pictures.length = got.took.length = 0')
await page.evaluate('window.ages = []; setInterval(() => ages.push(trocar.age.at(performance.now())), 50)')
const before = usage()
await page.waitForTimeout(1000 * Number(seconds))
const after = usage()
const between = (times) => times.slice(1).map((time, i) => time - times[i])
const say = (name, times) => console.log(`${name}: ${times.length} in ${((times.at(-1) - times[0]) / 1000).toFixed(1)} s; ms between two: p50 ${quantile(between(times), 0.5).toFixed(1)}, p99 ${quantile(between(times), 0.99).toFixed(1)}`)
const { pictures, took } = await page.evaluate('got')
say('pictures from the server', pictures)
console.log(`computing both images: ${took.length}; p50 ${quantile(took, 0.5).toFixed(1)}, p99 ${quantile(took, 0.99).toFixed(1)} ms`)
for (const [name, slice] of [['axial images shown', 'trocar.echo'], ['sagittal images shown', 'trocar.procedure.sagittal']]) say(name, await page.evaluate(`${slice}.frames`))
const ages = await page.evaluate('ages')
console.log(`age of the picture in the 3D view: p50 ${quantile(ages, 0.5).toFixed(2)}, p99 ${quantile(ages, 0.99).toFixed(2)} s`)
for (const [kind, { user, system, faults }] of Object.entries(after)) {
  const { user: u, system: s, faults: f } = before[kind] ?? { user: 0, system: 0, faults: 0 }, part = (seconds_) => `${(100 * seconds_ / Number(seconds)).toFixed(0)} %`
  if (user - u + system - s > 0.01 * Number(seconds)) console.log(`${kind}: user ${part(user - u)}, system ${part(system - s)}, ${((faults - f) / Number(seconds)).toFixed(0)} page faults per second`)
}
if (picture) await page.screenshot({ path: picture })
await browser.close()
await stop(server)
await stop(view)
console.log(server.said.split('\n').filter((line) => /^(lateness|compute)/.test(line)).join('\n'))
process.exit(0)
