// By hand: what browsers cost the haptic loop, and the time from a pose to its picture; in a private network:
//   scripts/netns node tests/view/measure.mjs BUILD_DIR SOURCE_DIR [SECONDS] [BROWSERS]
import { once } from 'node:events'
import { launch, ready, run, scene } from './parts.mjs'

const [seconds = '20', most = '3'] = process.argv.slice(4)
const quantile = (values, q) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(q * values.length))]

/** The device plays the figure 8 while `count` browsers look on; prints what the server says of its loop. */
async function measure(count) {
  const server = run('server/trocar-server', '--scene', scene), view = run('view/trocar-view', '--scene', scene)
  await Promise.all([ready(server), ready(view)])
  const browser = count && await launch()
  const pages = []
  for (let i = 0; i < count; i++) {
    pages.push(await (await browser.newContext({ viewport: { width: 1280, height: 800 } })).newPage())
    await pages[i].goto('http://127.0.0.1:8686/')
  }
  const device = run('clients/trocar-device', '--script', 'figure8', '--duration', seconds, '--realtime'), latencies = []
  const collect = setInterval(async () => { for (const page of pages) latencies.push(...await page.evaluate('trocar.latency.splice(0)').catch(() => [])) }, 1000)
  await once(device, 'exit')
  clearInterval(collect)
  server.kill()
  await once(server, 'exit')
  if (browser) await browser.close()
  view.kill()
  console.log(`${count} browsers`)
  console.log(server.said.split('\n').filter((line) => /lateness|compute|tick|misses|round/.test(line)).map((line) => `  ${line}`).join('\n'))
  const settled = latencies.slice(Math.floor(latencies.length / 5)) // the first pictures load the page
  if (count) console.log(`  pose to picture: p50 ${quantile(settled, 0.5)?.toFixed(0)} ms, p95 ${quantile(settled, 0.95)?.toFixed(0)} ms, ${settled.length} pictures`)
}

for (const count of [0, ...Array.from({ length: Number(most) }, (_, i) => i + 1).filter((n) => n === 1 || n === Number(most)), 0]) await measure(count)
process.exit(0)
