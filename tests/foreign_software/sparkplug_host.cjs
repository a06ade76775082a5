// A Sparkplug B host application: it asks an edge node for its birth, writes one metric, and says what it gets.
"use strict";
const mqtt = require("mqtt");
const payloads = require("sparkplug-payload").get("spBv1.0");

const [url, group, node, device, metric] = process.argv.slice(2);
const client = mqtt.connect(url, { clientId: "npm-host", protocolVersion: 4 });
const command = (kind, target, one) =>
    client.publish(`spBv1.0/${group}/${kind}/${target}`, Buffer.from(payloads.encodePayload({ timestamp: Date.now(), metrics: [one] })));

client.on("connect", () =>
    client.subscribe("spBv1.0/#", { qos: 1 }, () => {
        command("NCMD", node, { name: "Node Control/Rebirth", type: "Boolean", value: true });
        command("DCMD", `${node}/${device}`, { name: metric, type: "Double", value: 42.5 });
    }),
);
client.on("message", (topic, data) => {
    const [, , kind, , from] = topic.split("/");
    if (!/^[ND](BIRTH|DATA)$/.test(kind)) return;
    const { seq, metrics } = payloads.decodePayload(data);
    console.log(
        JSON.stringify({
            kind,
            device: from ?? null,
            seq: Number(seq),
            metrics: Object.fromEntries(metrics.map((one) => [one.name ?? `#${one.alias}`, typeof one.value === "object" ? null : one.value])),
        }),
    );
});
process.stdin.resume();
process.stdin.on("end", () => process.exit(0));
