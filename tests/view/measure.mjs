// By hand: what browsers cost the haptic loop, and the time from a pose to its picture; in a private network:
//   scripts/netns node tests/view/measure.mjs BUILD_DIR SOURCE_DIR [SECONDS] [BROWSERS]
import { spawn } from 'node:child_process'
import { once } from 'node:events'
import { createRequire } from 'node:module'
import path from 'node:path'

const [programs, source, seconds = '20', most = '3'] = process.argv.slice(2)
const { chromium } = createRequire(path.join(source, 'view/page/package.json'))('playwright-core')
const scene = path.join(source, 'meshes/figure8.yaml')

function run(name, ...options) {
  const child = spawn(path.join(programs, name), options, { stdio: ['ignore', 'pipe', 'inherit'] })
  child.said = ''
  child.stdout.on('data', (piece) => { child.said += piece })
  return child
}

async function ready(child) { while (!child.said.includes('ready\n')) await new Promise((done) => setTimeout(done, 20)) }

const quantile = (values, q) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(q * values.length))]

/** The device plays the figure 8 while `count` browsers look on; prints what the server says of its loop. */
async function measure(count) {
  const server = run('server/trocar-server', '--scene', scene), view = run('view/trocar-view', '--scene', scene)
  await Promise.all([ready(server), ready(view)])
  const browser = count && await chromium.launch({ executablePath: '/usr/bin/chromium', args: ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'] })
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
