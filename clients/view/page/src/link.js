// The WebSocket to trocar-view: comes back by itself; answers each update, which asks for the next one.
import { sections } from './decode.js'

const ACKNOWLEDGE = 1, TAKE = 2, STEER = 3, RESET = 4, RELEASE = 5, PICTURE = 6
const RETRY = 500, RETRY_REFUSED = 2000 // ms
const TRY_AGAIN_LATER = 1013 // status code: trocar-view has refused this page and says why

export class Link {
  /** `handlers`: scene, picture, samples, status (each with what was decoded), received (after each message), open, closed (with
   *  the reason if trocar-view has refused this page, else ''). */
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

  send(kind, steer = [], data = null) {
    if (this.socket.readyState !== WebSocket.OPEN) return
    const bytes = new Uint8Array(32 + (data ? data.byteLength : 0)), head = new DataView(bytes.buffer)
    head.setUint32(0, kind, true)
    steer.forEach((value, i) => head.setFloat32(4 + 4 * i, value, true))
    if (data) bytes.set(new Uint8Array(data), 32)
    this.socket.send(bytes)
  }

  take() { this.send(TAKE) }
  release() { this.send(RELEASE) }
  reset() { this.send(RESET) }
  /** right, up, forward, pitch, yaw, roll: each -1 .. 1 of the greatest speed. */
  steer(command) { this.send(STEER, command) }
  sendPicture(png) { this.send(PICTURE, [], png) }
}
