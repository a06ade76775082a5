// An MQTT adapter: the TypeScript SDK and mqtt.js.
import { McpServer } from "@modelcontextprotocol/sdk/server/mcp.js";
import mqtt from "mqtt";
import { z } from "zod";

import { Failure, inTurn, serve, TIMEOUT_MS, tool } from "../tools.ts";

type QoS = 0 | 1 | 2;

const KEPT = 1000;
/** Characters of a payload; brokers end the connection at a packet that is larger than they take. */
const LONGEST = 65536;

const client = mqtt.connect(process.env.MQTT_URL ?? "mqtt://127.0.0.1:1883", {
  connectTimeout: TIMEOUT_MS,
  reconnectPeriod: 500,
  // A message that was published while there is no connection would be sent when there is one again.
  queueQoSZero: false,
  // mqtt.js takes a second subscription to a filter for done, also where the broker has answered none.
  resubscribe: false,
  // A broker that says nothing any more is noticed after one and a half times this.
  keepalive: 3,
});
client.on("error", (error) => console.error("MQTT:", error.message));

/** Forget what waits for an answer of the broker: mqtt.js would send a publication again after the next connect. */
function forget(): void {
  for (const id of Object.keys(client.outgoing)) client.removeOutgoingMessage(Number(id));
}
client.on("close", forget);

const subscriptions = new Map<string, QoS>();
client.on("connect", () => {
  for (const [filter, qos] of subscriptions) {
    client.subscribe(filter, { qos }, (error) => {
      if (!error) return;
      subscriptions.delete(filter);
      console.error("MQTT:", filter, "is subscribed no more:", error.message);
    });
  }
});

interface Message {
  topic: string;
  payload: string;
  encoding: "utf-8" | "base64";
  qos: number;
  retained: boolean;
}

const messages: Message[] = [];
let dropped = 0;
client.on("message", (topic, bytes, { qos, retain }) => {
  let [payload, encoding]: [string, Message["encoding"]] = [bytes.toString("base64"), "base64"];
  try {
    [payload, encoding] = [new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes), "utf-8"];
  } catch {
    // It is no text.
  }
  messages.push({ topic, payload, encoding, qos, retained: retain });
  if (messages.length > KEPT) dropped += messages.splice(0, messages.length - KEPT).length;
});

/** Do what the broker has to answer, within the time that it has. */
function asked<T>(signal: AbortSignal, exchange: () => Promise<T>): Promise<T> {
  return inTurn(signal, async () => {
    if (!client.connected) throw new Failure("connect_failed", "there is no connection to the broker; nothing was sent");
    let timer: NodeJS.Timeout | undefined;
    const late = new Promise<never>((_, reject) => {
      timer = setTimeout(() => reject(new Failure("timeout", "no answer of the broker in time")), TIMEOUT_MS);
    });
    try {
      return await Promise.race([exchange(), late]);
    } catch (error) {
      forget();
      if (error instanceof Failure) throw error;
      const { message } = error as Error;
      throw new Failure(message.startsWith("Subscribe error") ? "access_denied" : "connection_lost", message);
    } finally {
      clearTimeout(timer);
    }
  });
}

const qos = z.union([z.literal(0), z.literal(1), z.literal(2)]).default(0);
const filter = z
  .string()
  .min(1)
  .refine((text) => isFilter(text), "a wildcard stands alone in its level, # in the last one");
const topic = z
  .string()
  .min(1)
  .refine((text) => !/[+#\0]/.test(text) && Buffer.byteLength(text) <= 65535, "no wildcard, no null, 65535 bytes at most");

function isFilter(text: string): boolean {
  const levels = text.split("/");
  return (
    !text.includes("\0") &&
    Buffer.byteLength(text) <= 65535 &&
    levels.every((level, at) => !/[+#]/.test(level) || level === "+" || (level === "#" && at === levels.length - 1))
  );
}

function matches(filter: string, topic: string): boolean {
  if (/^[+#]/.test(filter) && topic.startsWith("$")) return false;
  const [wanted, found] = [filter.split("/"), topic.split("/")];
  const end = wanted.indexOf("#");
  const fixed = end < 0 ? wanted : wanted.slice(0, end);
  const long = end < 0 ? found.length === fixed.length : found.length >= fixed.length;
  return long && fixed.every((level, at) => level === "+" || level === found[at]);
}

const server = new McpServer({ name: "acme-mqtt", version: "1.1.0" });

tool(
  server,
  { name: "subscribe", description: "Subscribe to a topic filter", writes: false, arguments: { filter, qos } },
  async (given, signal) => {
    const [granted] = await asked(signal, () => client.subscribeAsync(given.filter, { qos: given.qos }));
    subscriptions.set(given.filter, given.qos);
    return { filter: given.filter, granted_qos: granted.qos };
  },
);

tool(
  server,
  {
    name: "read_messages",
    description: `The last ${KEPT} messages received that a topic filter selects`,
    writes: false,
    arguments: { filter },
  },
  async (given) => {
    if (!client.connected) throw new Failure("connection_lost", "there is no connection to the broker");
    return { messages: messages.filter((message) => matches(given.filter, message.topic)), dropped };
  },
);

tool(
  server,
  {
    name: "publish",
    description: "Publish a text",
    writes: true,
    arguments: { topic, payload: z.string().max(LONGEST), qos, retain: z.boolean().default(false) },
  },
  async (given, signal) => {
    const { topic, payload, qos, retain } = given;
    await asked(signal, () => client.publishAsync(topic, payload, { qos, retain }));
    return { topic, delivery: qos === 0 ? "unacknowledged" : "acknowledged" };
  },
);

await serve(server, () => client.endAsync(true));
