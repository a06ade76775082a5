// A Modbus adapter as one writes it after the quick start of the TypeScript SDK and the README of modbus-serial.
import { McpServer } from "@modelcontextprotocol/sdk/server/mcp.js";
import { StdioServerTransport } from "@modelcontextprotocol/sdk/server/stdio.js";
import ModbusRTU from "modbus-serial";
import { z } from "zod";

const host = process.env.MODBUS_HOST ?? "127.0.0.1";
const port = Number(process.env.MODBUS_PORT ?? 502);

const client = new ModbusRTU.default();
await client.connectTCP(host, { port });
client.setID(1);

const server = new McpServer({ name: "acme-modbus", version: "1.0.0" });

server.registerTool(
  "read_holding_registers",
  {
    description: "Read holding registers",
    inputSchema: { address: z.number(), count: z.number().default(1) },
  },
  async ({ address, count }) => {
    const { data } = await client.readHoldingRegisters(address, count);
    return { content: [{ type: "text", text: JSON.stringify(data) }] };
  },
);

server.registerTool(
  "read_input_registers",
  {
    description: "Read input registers",
    inputSchema: { address: z.number(), count: z.number().default(1) },
  },
  async ({ address, count }) => {
    const { data } = await client.readInputRegisters(address, count);
    return { content: [{ type: "text", text: JSON.stringify(data) }] };
  },
);

server.registerTool(
  "write_register",
  {
    description: "Write one holding register",
    inputSchema: { address: z.number(), value: z.number() },
  },
  async ({ address, value }) => {
    await client.writeRegister(address, value);
    return { content: [{ type: "text", text: `Wrote ${value} to register ${address}` }] };
  },
);

await server.connect(new StdioServerTransport());
