// An OPC UA adapter as one writes it after the quick start of the TypeScript SDK and the README of node-opcua.
import { McpServer } from "@modelcontextprotocol/sdk/server/mcp.js";
import { StdioServerTransport } from "@modelcontextprotocol/sdk/server/stdio.js";
import { AttributeIds, DataType, OPCUAClient } from "node-opcua-client";
import { z } from "zod";

const client = OPCUAClient.create({ endpointMustExist: false });
await client.connect(process.env.OPCUA_URL ?? "opc.tcp://127.0.0.1:4840");
const session = await client.createSession();

const server = new McpServer({ name: "acme-opcua", version: "1.0.0" });

server.registerTool(
  "read_node",
  { description: "Read the value of a node", inputSchema: { node_id: z.string() } },
  async ({ node_id }) => {
    const { value } = await session.read({ nodeId: node_id, attributeId: AttributeIds.Value });
    return { content: [{ type: "text", text: JSON.stringify({ value: value.value }) }] };
  },
);

server.registerTool(
  "write_node",
  { description: "Write a number to a node", inputSchema: { node_id: z.string(), value: z.number() } },
  async ({ node_id, value }) => {
    await session.write({
      nodeId: node_id,
      attributeId: AttributeIds.Value,
      value: { value: { dataType: DataType.Double, value } },
    });
    return { content: [{ type: "text", text: JSON.stringify({ written: value }) }] };
  },
);

await server.connect(new StdioServerTransport());
