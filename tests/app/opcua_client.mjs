// A client of the package node-opcua: node opcua_client.mjs URL FOLDER USER SECRET URI. FOLDER has own/certificate.pem and
// own/key.pem. Prints what it finds as JSON.

import { join } from "node:path";
import certificates from "node-opcua-certificate-manager";
import {
  AttributeIds,
  ClientMonitoredItem,
  ClientSubscription,
  DataType,
  makeBrowsePath,
  MessageSecurityMode,
  OPCUAClient,
  SecurityPolicy,
  TimestampsToReturn,
  UserTokenType,
} from "node-opcua-client";

const [url, folder, userName, password, applicationUri] = process.argv.slice(2);
const client = OPCUAClient.create({
  applicationUri,
  certificateFile: join(folder, "own", "certificate.pem"),
  privateKeyFile: join(folder, "own", "key.pem"),
  clientCertificateManager: new certificates.OPCUACertificateManager({
    automaticallyAcceptUnknownCertificate: true,
    rootFolder: join(folder, "pki"),
  }),
  securityMode: MessageSecurityMode.SignAndEncrypt,
  securityPolicy: SecurityPolicy.Basic256Sha256,
  endpointMustExist: false,
  connectionStrategy: { maxRetry: 1, initialDelay: 100 },
});

const found = {};
try {
  await client.connect(url);
  const session = await client.createSession({ type: UserTokenType.UserName, userName, password });
  const namespaces = await session.readNamespaceArray();
  const di = namespaces.indexOf("http://opcfoundation.org/UA/DI/");
  const machinery = namespaces.indexOf("http://opcfoundation.org/UA/Machinery/");
  const path = `/${machinery}:Machines/1:dry-end/${di}:Identification/${di}:SerialNumber`;
  const serial = (await session.translateBrowsePath(makeBrowsePath("ObjectsFolder", path))).targets[0].targetId;
  found.serial = (await session.read({ nodeId: serial, attributeId: AttributeIds.Value })).value.value;
  const actual = "ns=1;s=dry-end/1/Speed/Actual";
  const read = await session.read({ nodeId: actual, attributeId: AttributeIds.Value });
  found.actual = [read.value.value, read.statusCode.name, DataType[read.value.dataType]];
  found.at = read.sourceTimestamp.toISOString();
  const unit = await session.read({ nodeId: `${actual}/EngineeringUnits`, attributeId: AttributeIds.Value });
  found.unit = [unit.value.value.displayName.text, unit.value.value.unitId];
  const bad = await session.read({ nodeId: "ns=1;s=dry-end/3/Speed/Actual", attributeId: AttributeIds.Value });
  found.unread = bad.statusCode.name;
  const parts = await session.browse({ nodeId: "ns=1;s=dry-end/1", browseDirection: 0 });
  found.parts = parts.references.map((each) => each.browseName.name);
  const status = await session.write({
    nodeId: actual,
    attributeId: AttributeIds.Value,
    value: { value: { dataType: DataType.Double, value: 1 } },
  });
  found.write = status.name;
  const subscription = ClientSubscription.create(session, { requestedPublishingInterval: 200, publishingEnabled: true });
  const item = ClientMonitoredItem.create(
    subscription,
    { nodeId: actual, attributeId: AttributeIds.Value },
    { samplingInterval: 100, queueSize: 5 },
    TimestampsToReturn.Both,
  );
  found.subscribed = await new Promise((resolve) => item.on("changed", (data) => resolve(data.value.value)));
  await session.close();
} catch (error) {
  found.error = String(error.message ?? error);
}
await client.disconnect();
console.log(JSON.stringify(found));
process.exit(0);
