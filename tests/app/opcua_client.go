// A client of gopcua: opcua_client URL FOLDER USER SECRET. FOLDER has own/certificate.pem and own/key.pem. Prints what it
// finds as JSON.
package main

import (
	"context"
	"crypto/rsa"
	"crypto/x509"
	"encoding/json"
	"encoding/pem"
	"fmt"
	"os"
	"path/filepath"
	"time"

	"github.com/gopcua/opcua"
	"github.com/gopcua/opcua/ua"
)

func main() {
	url, folder, user, secret := os.Args[1], os.Args[2], os.Args[3], os.Args[4]
	found := map[string]any{}
	if err := look(found, url, folder, user, secret); err != nil {
		found["error"] = err.Error()
	}
	text, _ := json.Marshal(found)
	fmt.Println(string(text))
}

func look(found map[string]any, url, folder, user, secret string) error {
	ctx, cancel := context.WithTimeout(context.Background(), 30*time.Second)
	defer cancel()
	endpoints, err := opcua.GetEndpoints(ctx, url)
	if err != nil {
		return err
	}
	endpoint, err := opcua.SelectEndpoint(endpoints, ua.SecurityPolicyURIBasic256Sha256, ua.MessageSecurityModeSignAndEncrypt)
	if err != nil {
		return err
	}
	text, err := os.ReadFile(filepath.Join(folder, "own", "key.pem"))
	if err != nil {
		return err
	}
	block, _ := pem.Decode(text)
	parsed, err := x509.ParsePKCS8PrivateKey(block.Bytes)
	if err != nil {
		return err
	}
	key := parsed.(*rsa.PrivateKey)
	client, err := opcua.NewClient(url,
		opcua.CertificateFile(filepath.Join(folder, "own", "certificate.pem")),
		opcua.PrivateKey(key),
		opcua.AuthUsername(user, secret),
		opcua.SecurityFromEndpoint(endpoint, ua.UserTokenTypeUserName),
		opcua.AutoReconnect(false),
	)
	if err != nil {
		return err
	}
	if err := client.Connect(ctx); err != nil {
		return err
	}
	defer client.Close(ctx)
	actual := ua.NewStringNodeID(1, "dry-end/1/Speed/Actual")
	read, err := client.Read(ctx, &ua.ReadRequest{
		NodesToRead: []*ua.ReadValueID{
			{NodeID: actual, AttributeID: ua.AttributeIDValue},
			{NodeID: ua.NewStringNodeID(1, "dry-end/3/Speed/Actual"), AttributeID: ua.AttributeIDValue},
		},
		TimestampsToReturn: ua.TimestampsToReturnBoth,
	})
	if err != nil {
		return err
	}
	found["actual"] = []any{read.Results[0].Value.Value(), uint32(read.Results[0].Status)}
	found["at"] = read.Results[0].SourceTimestamp
	found["unread"] = read.Results[1].Status.Error()
	var parts []string
	references, err := client.Node(ua.NewStringNodeID(1, "dry-end/1")).ReferencedNodes(ctx, 0, ua.BrowseDirectionForward, ua.NodeClassObject, true)
	if err != nil {
		return err
	}
	for _, node := range references {
		name, err := node.BrowseName(ctx)
		if err != nil {
			return err
		}
		parts = append(parts, name.Name)
	}
	found["parts"] = parts
	written, err := client.Write(ctx, &ua.WriteRequest{NodesToWrite: []*ua.WriteValue{{
		NodeID:      actual,
		AttributeID: ua.AttributeIDValue,
		Value:       &ua.DataValue{EncodingMask: ua.DataValueValue, Value: ua.MustVariant(1.0)},
	}}})
	if err != nil {
		return err
	}
	found["write"] = written.Results[0].Error()
	changes := make(chan *opcua.PublishNotificationData, 10)
	subscription, err := client.Subscribe(ctx, &opcua.SubscriptionParameters{Interval: 200 * time.Millisecond}, changes)
	if err != nil {
		return err
	}
	defer subscription.Cancel(ctx)
	wanted := opcua.NewMonitoredItemCreateRequestWithDefaults(actual, ua.AttributeIDValue, 1)
	if _, err := subscription.Monitor(ctx, ua.TimestampsToReturnBoth, wanted); err != nil {
		return err
	}
	for change := range changes {
		if change.Error != nil {
			return change.Error
		}
		if data, ok := change.Value.(*ua.DataChangeNotification); ok && len(data.MonitoredItems) > 0 {
			found["subscribed"] = data.MonitoredItems[0].Value.Value.Value()
			return nil
		}
	}
	return nil
}
