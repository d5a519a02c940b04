// The WebSocket connection to trocar-view. Reconnects by itself, and acknowledges each update, which requests the next one.
import { sections } from './decode.js'

const ACKNOWLEDGE = 1, TAKE = 2, STEER = 3, RESET = 4, RELEASE = 5, PICTURE = 6, HOLE = 7, DROP = 8, UNDO = 9, LEAVE = 10, REMOVE = 11, PROBE = 12, START = 13, FINISH = 14, LOOK = 15, CHANGE = 16
const RETRY = 500, RETRY_REFUSED = 2000 // ms
const TRY_AGAIN_LATER = 1013 // close code; trocar-view refused this page and gave a reason

export class Link {
  /** `handlers`: scene, picture, samples, status, seeds, reply, dose, plan and ultrasound are called with the decoded content; received after each
   * message; open; closed with the reason if trocar-view refused this page, otherwise with ''. */
  constructor(handlers) {
    this.handlers = handlers
    this.connect()
  }

  connect() {
    const address = new URL('.', location.href)
    address.protocol = address.protocol.replace('http', 'ws')
    this.socket = new WebSocket(address, 'trocar-view')
    this.socket.binaryType = 'arraybuffer'
    this.socket.onopen = () => this.handlers.open()
    this.socket.onmessage = (event) => this.receive(event.data)
    this.socket.onclose = ({ code, reason }) => {
      const refused = code === TRY_AGAIN_LATER
      this.handlers.closed(refused ? reason : '')
      setTimeout(() => this.connect(), refused ? RETRY_REFUSED : RETRY)
    }
  }

  receive(message) {
    for (const [name, content] of sections(message)) this.handlers[name](content)
    this.handlers.received()
    this.send(ACKNOWLEDGE)
  }

  send(kind, steer = [], data = null, needle = 0) {
    if (this.socket.readyState !== WebSocket.OPEN) return
    const bytes = new Uint8Array(32 + (data ? data.byteLength : 0)), head = new DataView(bytes.buffer)
    head.setUint32(0, kind, true)
    steer.forEach((value, i) => head.setFloat32(4 + 4 * i, value, true))
    head.setUint32(28, needle, true)
    if (data) bytes.set(new Uint8Array(data), 32) // copies a typed array or a buffer
    this.socket.send(bytes)
  }

  take(needle) { this.send(TAKE, [], null, needle) }
  release() { this.send(RELEASE) }
  reset() { this.send(RESET) }
  /** Steers the needle: right, up, forward, pitch, yaw and roll, each as a fraction (-1 to 1) of its maximum speed. The next status returns `number`. */
  steer(command, number) { this.send(STEER, command, null, number) }
  /** Moves the driven needle to its waiting pose in front of this hole, unless it is in the tissue. */
  goToHole(guide, column, row) { this.send(HOLE, [guide, column, row]) }
  /** Drops one seed, or a strand of several. */
  drop(seeds) { this.send(DROP, [seeds]) }
  undo() { this.send(UNDO) }
  /** Leaves the driven needle to rest. (In a scene with a template, a needle that is released in the tissue also comes to rest.) */
  leave() { this.send(LEAVE) }
  /** Pulls out a needle that is resting or that nobody holds. */
  remove(needle) { this.send(REMOVE, [], null, needle) }
  /** Steers the probe, with the same arguments as `steer`. */
  moveProbe(command, number) { this.send(PROBE, command, null, number) }
  /** Requests computed ultrasound images, which then arrive for about two seconds: the axial image in the plane z (m) and, if `both` is true, the
   * sagittal image in the plane x. If there is a probe, the images are at the probe. `depth` is in m; 0 means deep enough to cover the gland. */
  lookAt(z, x, depth, both) { this.send(LOOK, [z, x, depth, both ? 1 : 0]) }
  /** Start and end a trainee's task and its recording. */
  startTask() { this.send(START) }
  /** `language`: language of the report, such as "de". */
  finishTask(language) { this.send(FINISH, [], null, language.charCodeAt(0) | language.charCodeAt(1) << 8) }
  /** Changes the tissue over `seconds`. `values` are lines of "key: value". The status with the server's reply returns `number`. */
  change(values, seconds, number) { this.send(CHANGE, [seconds], new TextEncoder().encode(values), number) }
  sendPicture(png) { this.send(PICTURE, [], png) }
}
