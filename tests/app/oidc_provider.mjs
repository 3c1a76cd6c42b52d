// The provider of the package oidc-provider on this machine, with one client. Prints its issuer; ends with its input.
// Each person exists, is called as it logs in, and is in the groups after the sign +: "anna+line-operators".
import { createServer } from "node:http";
import { Provider } from "oidc-provider";

const [client_id, client_secret, redirect_uri] = process.argv.slice(2);
const server = createServer();
server.listen(0, "127.0.0.1", () => {
  const issuer = `http://127.0.0.1:${server.address().port}`;
  const provider = new Provider(issuer, {
    claims: { openid: ["sub"], profile: ["preferred_username", "groups"], email: ["email"] },
    clients: [{ client_id, client_secret, redirect_uris: [redirect_uri] }],
    conformIdTokenClaims: false,
    cookies: { keys: ["of a test"] },
    findAccount: (_, accountId) => {
      const [preferred_username, ...groups] = accountId.split("+");
      return { accountId, claims: () => ({ sub: accountId, preferred_username, groups, email: "x@plant.example" }) };
    },
    pkce: { required: () => true },
  });
  server.on("request", provider.callback());
  console.log(issuer);
});
process.stdin.on("end", () => process.exit()).resume();
