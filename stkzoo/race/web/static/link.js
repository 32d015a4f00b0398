// Connection to the race. It reconnects automatically.

const VERSION = 1;
const SLOWEST_RETRY = 3000; // [ms]

export class Link {
  constructor({ onMessage, onLost }) {
    this.onMessage = onMessage;
    this.onLost = onLost;
    this.retry = 300;
    this.key = new URLSearchParams(location.hash.slice(1)).get("key") ?? "";
    this.open();
  }

  open() {
    const query = new URLSearchParams({ version: VERSION, key: this.key });
    this.socket = new WebSocket(`ws://${location.host}/live?${query}`);
    this.socket.onmessage = (event) => {
      this.retry = 300;
      this.onMessage(JSON.parse(event.data));
    };
    this.socket.onclose = () => {
      this.onLost();
      setTimeout(() => this.open(), this.retry);
      this.retry = Math.min(this.retry * 1.6, SLOWEST_RETRY);
    };
  }

  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }
}
