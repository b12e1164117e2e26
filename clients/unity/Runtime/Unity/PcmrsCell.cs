using System;
using System.Net;
using UnityEngine;

namespace Pcmrs.Unity
{
    /// <summary>A connection to the daemon of one cell, for as long as it is enabled.</summary>
    [AddComponentMenu("PCMRS/Cell")]
    public sealed class PcmrsCell : MonoBehaviour
    {
        [Tooltip("IPv4 address of the daemon")]
        public string daemon = "127.0.0.1";

        [Tooltip("gateway.planner.port")]
        public int commandPort = 8057;

        [Tooltip("gateway.mixed_reality.stream_port; this machine is gateway.mixed_reality_host")]
        public int streamPort = 8051;

        [Tooltip("gateway.openigtlink.port; 0 where it is not enabled: then there is no state")]
        public int statePort = 18944;

        [Tooltip("Name in gateway.peers; empty on the daemon's own machine, where commands need no signature")]
        public string peer = "";

        [Tooltip("Path of the peer's key; in no folder that is built into the player")]
        public string keyFile = "";

        [Tooltip("Drops answers that are not signed: for a peer with counter = \"unix_ns\"")]
        public bool answersSigned;

        private StreamReceiver receiver;
        private CommandLink commands;
        private StateLink stateLink;
        private Exception shown;

        /// <summary>The commands; null while disabled.</summary>
        public Planner Planner { get; private set; }

        /// <summary>Tool, target and registration; null while disabled.</summary>
        public PoseStreams Poses { get; private set; }

        /// <summary>The state of the cell; null while it is not heard.</summary>
        public CellState State => stateLink?.State;

        /// <summary>Stops everything at once; for a button.</summary>
        public async void Stop()
        {
            try
            {
                await Planner.StopAsync();
            }
            catch (Exception error)
            {
                Debug.LogException(error);
            }
        }

        private void OnEnable()
        {
            IPAddress address = IPAddress.Parse(daemon);
            Signer signer = peer == "" ? null : new Signer(peer, Signer.ReadKey(keyFile), answersSigned);
            receiver = new StreamReceiver(address, streamPort);
            commands = new CommandLink(new IPEndPoint(address, commandPort), signer);
            stateLink = statePort == 0 ? null : new StateLink(new IPEndPoint(address, statePort));
            Planner = new Planner(commands);
            Poses = new PoseStreams(receiver, Planner);
        }

        private void OnDisable()
        {
            Poses?.Dispose();
            stateLink?.Dispose();
            commands?.Dispose();
            receiver?.Dispose();
            Planner = null;
            Poses = null;
            stateLink = null;
        }

        private void Update()
        {
            Exception failure = Poses?.Failure;
            if (failure?.Message != shown?.Message && failure != null)
            {
                Debug.LogWarning("PCMRS: " + failure.Message);
            }
            shown = failure;
        }
    }
}
