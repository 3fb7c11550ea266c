/** The page's socket: it reconnects by itself, and sends the token where one is needed. */

const LATER = [0.5, 1, 2, 5]; // s until the next attempt

function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname); // hides the token, and keeps it out of bookmarks
  }
  return sessionStorage.getItem("token");
}

export class Connection {
  /** `received` is called with every message; `changed` with the state (live, lost, refused) and its reason. */
  constructor(received, changed) {
    this.received = received;
    this.changed = changed;
    this.attempts = 0;
    this.token = takeToken();
    addEventListener("hashchange", () => location.reload()); // a token was added to the address
    this.open();
  }

  open() {
    const socket = new WebSocket(`ws://${location.host}/socket`);
    this.socket = socket;
    socket.onopen = () => {
      socket.send(JSON.stringify({ token: this.token ?? "" })); // only the server knows whether a token is required
    };
    socket.onmessage = (event) => {
      this.attempts = 0;
      this.received(JSON.parse(event.data));
    };
    socket.onclose = (event) => {
      if (event.code === 4401) {
        sessionStorage.removeItem("token");
        this.changed("refused", event.reason);
        return;
      }
      const wait = LATER[Math.min(this.attempts, LATER.length - 1)];
      this.attempts += 1;
      this.changed("lost", `connection lost; trying again${event.reason ? ` (${event.reason})` : ""}`);
      setTimeout(() => this.open(), 1000 * wait);
    };
  }

  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }
}
