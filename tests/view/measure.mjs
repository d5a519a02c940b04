/* Measures the effect of browsers on the haptic loop, and the time from a pose to its picture. Run by hand, in a private network:
   scripts/netns node tests/view/measure.mjs BUILD_DIR SOURCE_DIR [SECONDS] [BROWSERS] [ROUNDS]
   Runs with and without browsers alternate, because other load on the machine changes the loop's times as much as browsers do; the medians of the runs are
   compared. */
import { once } from 'node:events'
import { ADDRESS, launch, run, start, stop } from './parts.mjs'

const [seconds = '8', most = '3', rounds = '9'] = process.argv.slice(4)
const quantile = (values, q) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(q * values.length))]
const median = (values) => quantile(values, 0.5)

/** Returns the p50 and p99 (us) printed by the server. */
const times = (said, name) => new RegExp(`^${name} +p50 ([0-9.]+) us, p99 ([0-9.]+) us`, 'm').exec(said).slice(1).map(Number)

/** Plays the figure-8 motion with the device while `count` browsers show it. */
async function measure(count) {
  const server = await start('server/trocar-server'), view = await start('clients/view/trocar-view'), browser = count && await launch(), pages = [], pictures = []
  for (let i = 0; i < count; i++) {
    pages.push(await (await browser.newContext({ viewport: { width: 1280, height: 800 } })).newPage())
    await pages[i].goto(ADDRESS)
  }
  const collect = async () => { for (const page of pages) pictures.push(...await page.evaluate('trocar.latency.splice(0)')) }
  const device = run('clients/trocar-device', '--script', 'figure8', '--duration', seconds, '--realtime'), timer = setInterval(() => collect().catch(() => {}), 1000)
  await once(device, 'exit')
  clearInterval(timer)
  await collect()
  await stop(server)
  if (browser) await browser.close()
  await stop(view)
  const lateness = times(server.said, 'lateness'), tick = times(server.said, 'compute')
  console.log(`${count} browsers: lateness ${lateness.join(', ')} us, tick ${tick.join(', ')} us (p50, p99)`)
  return { lateness, tick, pictures: pictures.slice(Math.floor(pictures.length / 5)) } // while the first pictures arrive, the page is still loading
}

/** Prints the medians over the runs. Returns the medians of p99. */
function summarise(count, runs) {
  const [late50, late99, tick50, tick99] = ['lateness', 'tick'].flatMap((name) => [0, 1].map((k) => median(runs.map((each) => each[name][k]))))
  const pictures = runs.flatMap((each) => each.pictures)
  console.log(`${count} browsers, medians of ${runs.length} runs: lateness p50 ${late50}, p99 ${late99} us; tick p50 ${tick50}, p99 ${tick99} us`
    + (count ? `; pose to picture p50 ${median(pictures).toFixed(0)}, p95 ${quantile(pictures, 0.95).toFixed(0)} ms, ${pictures.length} pictures` : ''))
  return { lateness: late99, tick: tick99 }
}

const without = [], one = [], several = []
for (let round = 0; round < Number(rounds); round++) {
  without.push(await measure(0))
  if (round < Number(rounds) / 3) one.push(await measure(1))
  several.push(await measure(Number(most)))
}
const alone = summarise(0, without)
summarise(1, one)
const beside = summarise(Number(most), several)
console.log(`p99 with ${most} browsers / without: lateness ${(beside.lateness / alone.lateness).toFixed(2)}, tick ${(beside.tick / alone.tick).toFixed(2)}`)
process.exit(0)
