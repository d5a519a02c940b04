// Shared by page.mjs, measure.mjs and soak.mjs. The first two arguments of all these scripts are BUILD_DIR and SOURCE_DIR.
import assert from 'node:assert/strict'
import { spawn } from 'node:child_process'
import { createRequire } from 'node:module'
import { once } from 'node:events'
import path from 'node:path'

export const [programs, source] = process.argv.slice(2, 4).map((folder) => path.resolve(folder))
const modules = createRequire(path.join(source, 'clients/view/page/package.json')), { chromium } = modules('playwright-core')

/** The source of axe-core, which checks accessibility. */
export const axe = modules('axe-core').source

export const ADDRESS = 'http://127.0.0.1:8686/'
export const scene = path.join(source, 'meshes/prostate.yaml')

/** Starts a program. `said` is its output so far. */
export function run(name, ...options) {
  const child = spawn(path.join(programs, name), options, { stdio: ['ignore', 'pipe', 'inherit'] })
  child.said = ''
  child.stdout.on('data', (piece) => { child.said += piece })
  return child
}

const ended = (child) => child.exitCode !== null || child.signalCode !== null

/** Waits until the program prints the line "ready". */
export async function ready(child) {
  while (!child.said.includes('ready\n')) {
    assert(!ended(child), `${child.spawnfile} ended: ${child.said}`)
    await new Promise((done) => setTimeout(done, 20))
  }
  return child
}

/** Starts a program with the scene and waits until it is ready. */
export const start = (name, ...options) => ready(run(name, '--scene', scene, ...options))

export async function stop(child, signal = 'SIGTERM') {
  child?.kill(signal)
  if (child && !ended(child)) await once(child, 'exit')
}

/** Starts Chromium with software rendering, as on a machine without a graphics card. */
export const launch = () => chromium.launch({ executablePath: '/usr/bin/chromium', args: ['--no-sandbox', '--disable-gpu', '--enable-unsafe-swiftshader'] })
