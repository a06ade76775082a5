// A client with one subscription, built as Node adapters build theirs. One JSON line for each event; it ends with its input.
"use strict";
const opcua = require("node-opcua-client");

const say = (event, more) => console.log(JSON.stringify({ event, ...more }));

async function main(url, nodeId) {
    const client = opcua.OPCUAClient.create({
        endpointMustExist: false,
        keepSessionAlive: true,
        connectionStrategy: { initialDelay: 100, maxDelay: 200, maxRetry: -1 },
    });
    client.on("connection_reestablished", () => say("reestablished"));
    await client.connect(url);
    const session = await client.createSession();
    const subscription = opcua.ClientSubscription.create(session, {
        requestedPublishingInterval: 100,
        requestedLifetimeCount: 1000,
        requestedMaxKeepAliveCount: 10,
        publishingEnabled: true,
        priority: 1,
    });
    const item = opcua.ClientMonitoredItem.create(
        subscription,
        { nodeId, attributeId: opcua.AttributeIds.Value },
        { samplingInterval: 50, discardOldest: true, queueSize: 10 },
        opcua.TimestampsToReturn.Both,
    );
    item.on("changed", (data) => say("value", { value: data.value.value }));
    process.stdin.resume();
    process.stdin.on("end", () => process.exit(0));
}

main(...process.argv.slice(2)).catch((error) => {
    say("error", { message: String(error) });
    process.exit(1);
});
