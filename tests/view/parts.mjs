// What measure.mjs and soak.mjs share.
import { spawn } from 'node:child_process'
import { createRequire } from 'node:module'
import path from 'node:path'

const [programs, source] = process.argv.slice(2, 4).map((folder) => path.resolve(folder))
const { chromium } = createRequire(path.join(source, 'view/page/package.json'))('playwright-core')

export const scene = path.join(source, 'meshes/prostate.yaml')

/** Starts a program; `said` is what it has printed. */
export function run(name, ...options) {
  const child = spawn(path.join(programs, name), options, { stdio: ['ignore', 'pipe', 'inherit'] })
  child.said = ''
  child.stdout.on('data', (piece) => { child.said += piece })
  return child
}

export async function ready(child) { while (!child.said.includes('ready\n')) await new Promise((done) => setTimeout(done, 20)) }

/** Chromium as on a machine without a graphics card: the processor draws. */
export const launch = (...more) => chromium.launch({ executablePath: '/usr/bin/chromium', args: ['--no-sandbox', '--disable-gpu', '--enable-unsafe-swiftshader', ...more] })
