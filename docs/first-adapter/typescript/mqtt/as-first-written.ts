// An MQTT adapter as one writes it after the quick start of the TypeScript SDK and the README of mqtt.js.
import { McpServer } from "@modelcontextprotocol/sdk/server/mcp.js";
import { StdioServerTransport } from "@modelcontextprotocol/sdk/server/stdio.js";
import mqtt from "mqtt";
import { z } from "zod";

const client = mqtt.connect(process.env.MQTT_URL ?? "mqtt://127.0.0.1:1883");

const messages: { topic: string; payload: string }[] = [];
client.on("message", (topic, payload) => {
  messages.push({ topic, payload: payload.toString() });
});
client.on("error", (error) => console.error("MQTT:", error.message));

const server = new McpServer({ name: "acme-mqtt", version: "1.0.0" });

server.registerTool("status", { description: "Is the broker connected?" }, async () => ({
  content: [{ type: "text", text: JSON.stringify({ connected: client.connected }) }],
}));

server.registerTool(
  "subscribe",
  { description: "Subscribe to a topic", inputSchema: { topic: z.string(), qos: z.number().default(0) } },
  async ({ topic, qos }) => {
    await client.subscribeAsync(topic, { qos: qos as 0 | 1 | 2 });
    return { content: [{ type: "text", text: JSON.stringify({ subscribed: topic }) }] };
  },
);

server.registerTool("read_messages", { description: "The messages received so far" }, async () => ({
  content: [{ type: "text", text: JSON.stringify(messages) }],
}));

server.registerTool(
  "publish",
  {
    description: "Publish a message",
    inputSchema: { topic: z.string(), payload: z.string(), qos: z.number().default(0) },
  },
  async ({ topic, payload, qos }) => {
    await client.publishAsync(topic, payload, { qos: qos as 0 | 1 | 2 });
    return { content: [{ type: "text", text: JSON.stringify({ published: topic }) }] };
  },
);

await server.connect(new StdioServerTransport());
