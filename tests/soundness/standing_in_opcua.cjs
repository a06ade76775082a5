// An OPC UA server of another author, which stands for a real one. It names its port on its first line; at each line of its input it
// says what it has been asked for, service by service, and what the variables hold; it ends with its input, unless it is told to stay.
"use strict";
const { OPCUAServer } = require("node-opcua-server");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");
const { nodesets } = require("node-opcua-nodesets");
const { MessageSecurityMode, SecurityPolicy } = require("node-opcua-secure-channel");
const { DataType } = require("node-opcua-variant");

const plant = { Temperature: 21.5, Pressure: 1.1, Level: 3, Pump: true, Speed: 1480.25, Steps: 70000 };
const types = { Pressure: DataType.Float, Level: DataType.Int16, Pump: DataType.Boolean, Steps: DataType.UInt32 };

async function main(port, home, stays) {
    const manager = new OPCUACertificateManager({ rootFolder: `${home}/pki`, automaticallyAcceptUnknownCertificate: true });
    await manager.initialize();
    const server = new OPCUAServer({
        port: Number(port),
        hostname: "127.0.0.1",
        host: "127.0.0.1",
        nodeset_filename: [nodesets.standard],
        serverCertificateManager: manager,
        userCertificateManager: manager,
        userManager: { isValidUser: () => true },
        securityPolicies: [SecurityPolicy.None, SecurityPolicy.Basic256Sha256],
        securityModes: [MessageSecurityMode.None, MessageSecurityMode.SignAndEncrypt],
        buildInfo: { manufacturerName: "Foreign", productName: "Stand-in", softwareVersion: "1.0" },
    });
    await server.initialize();
    const space = server.engine.addressSpace;
    const own = space.getOwnNamespace();
    const folder = own.addFolder(space.rootFolder.objects, { browseName: "Plant", nodeId: "s=Plant" });
    const variables = {};
    for (const [name, value] of Object.entries(plant)) {
        variables[name] = own.addVariable({
            componentOf: folder,
            browseName: name,
            nodeId: `s=${name}`,
            dataType: DataType[types[name] ?? DataType.Double],
            value: { dataType: types[name] ?? DataType.Double, value },
        });
    }
    const asked = {};
    const writes = [];
    server.on("request", (request) => {
        const name = request.schema.name.replace(/Request$/, "");
        asked[name] = (asked[name] ?? 0) + 1;
        for (const item of request.nodesToWrite ?? []) writes.push([item.nodeId.toString(), item.value.value.value]);
    });
    await server.start();
    console.log(JSON.stringify({ port: server.endpoints[0].port, namespace: own.index }));
    require("readline")
        .createInterface({ input: process.stdin })
        .on("line", () => {
            const held = Object.fromEntries(Object.keys(plant).map((name) => [name, variables[name].readValue().value.value]));
            console.log(JSON.stringify({ asked, held, writes }));
        })
        .on("close", () => stays || process.exit(0));
}

// It says much else on its way.
console.log = ((genuine) => (text) => (String(text).startsWith("{") ? genuine(text) : console.error(text)))(console.log);
main(...process.argv.slice(2)).catch((error) => {
    console.error(error);
    process.exit(1);
});
