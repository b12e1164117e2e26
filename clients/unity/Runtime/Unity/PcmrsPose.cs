using UnityEngine;

namespace Pcmrs.Unity
{
    /// <summary>
    /// Puts this object, in its parent, where a pose of the cell is. Tool and target belong below the image, and the
    /// image, with the registration as its pose, below the patient's reference. An unknown pose is not shown.
    /// </summary>
    [AddComponentMenu("PCMRS/Pose")]
    public sealed class PcmrsPose : MonoBehaviour
    {
        public enum Source
        {
            Tool,
            Target,
            Registration,
        }

        public PcmrsCell cell;
        public Source source;

        [Tooltip("Shown while the pose is known: a child, since an object that is not active is not updated")]
        public GameObject visual;

        private void Update()
        {
            RigidPose pose = RigidPose.Identity;
            bool known = cell.Poses != null && cell.Poses.TryGet(KindOf(source), out pose);
            if (known)
            {
                transform.SetLocalPose(pose);
            }
            if (visual != null && visual.activeSelf != known)
            {
                visual.SetActive(known);
            }
        }

        private static StreamKind KindOf(Source source)
        {
            switch (source)
            {
                case Source.Target:
                    return StreamKind.Target;
                case Source.Registration:
                    return StreamKind.Registration;
                default:
                    return StreamKind.Tool;
            }
        }
    }
}
