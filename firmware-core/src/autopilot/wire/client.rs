// SPDX-License-Identifier: MIT OR Apache-2.0
//! The messages between the client and an autopilot. A program that sends and takes only these
//! does not contain the code for the rest of the dialect.

use mavlink::dialects::common::MavMessage;
use mavlink::error::ParserError;
use mavlink::{MavlinkVersion, MessageData};

/// Generates a parser and a serializer for a list of messages.
macro_rules! messages {
    (taken { $($taken:ident($taken_data:ident),)* } sent { $($sent:ident,)* }) => {
        use mavlink::dialects::common::{$($taken_data,)*};

        /// Returns the message with this id, or `None` if the client does not take it.
        pub(super) fn parse(id: u32, payload: &[u8]) -> Result<Option<MavMessage>, ParserError> {
            Ok(Some(match id {
                $($taken_data::ID => {
                    MavMessage::$taken($taken_data::deser(MavlinkVersion::V2, payload)?)
                })*
                _ => return Ok(None),
            }))
        }

        /// Writes a message that the client sends and returns its length. Returns `None` for any other
        /// message.
        pub(super) fn write(message: &MavMessage, payload: &mut [u8]) -> Option<usize> {
            Some(match message {
                $(MavMessage::$sent(data) => data.ser(MavlinkVersion::V2, payload),)*
                _ => return None,
            })
        }

        #[cfg(test)]
        mod tests {
            use super::*;
            use mavlink::Message;

            /// The messages of the lists, and no others, are read and written, as by the code for the
            /// whole dialect.
            #[test]
            fn each_is_read_and_written_as_by_the_dialect() {
                let taken = [$(MavMessage::$taken(Default::default()).message_id()),*];
                let sent = [$(MavMessage::$sent(Default::default()).message_id()),*];
                let mut ids = 0;
                for id in 0..70_000 {
                    let Some(message) = MavMessage::default_message_from_id(id) else {
                        assert_eq!(MavMessage::extra_crc(id), 0);
                        continue;
                    };
                    let seed_is_zero = MavMessage::extra_crc(id) == 0;
                    assert_eq!(seed_is_zero, id == super::super::layout::SEED_ZERO, "message {id}");
                    ids += 1;
                    let mut whole = [0; 255];
                    let length = message.ser(MavlinkVersion::V2, &mut whole);
                    let mut ours = [0; 255];
                    let written = write(&message, &mut ours).map(|length| (length, ours));
                    let expected = sent.contains(&id).then_some((length, whole));
                    assert_eq!(written, expected, "message {id}");
                    let read = parse(id, &whole[..length]).expect("sound");
                    let expected = taken.contains(&id).then_some(message);
                    assert_eq!(read, expected, "message {id}");
                }
                assert!(ids > 200);
            }
        }
    };
}

messages! {
    taken {
        HEARTBEAT(HEARTBEAT_DATA),
        COMMAND_ACK(COMMAND_ACK_DATA),
        LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA),
        ESTIMATOR_STATUS(ESTIMATOR_STATUS_DATA),
        SYS_STATUS(SYS_STATUS_DATA),
        EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA),
        CURRENT_MODE(CURRENT_MODE_DATA),
        GPS_GLOBAL_ORIGIN(GPS_GLOBAL_ORIGIN_DATA),
        POSITION_TARGET_LOCAL_NED(POSITION_TARGET_LOCAL_NED_DATA),
        POSITION_TARGET_GLOBAL_INT(POSITION_TARGET_GLOBAL_INT_DATA),
        PARAM_VALUE(PARAM_VALUE_DATA),
        STATUSTEXT(STATUSTEXT_DATA),
        SYSTEM_TIME(SYSTEM_TIME_DATA),
    }
    sent {
        HEARTBEAT,
        COMMAND_LONG,
        PARAM_REQUEST_READ,
        PARAM_SET,
        SET_POSITION_TARGET_LOCAL_NED,
        SET_POSITION_TARGET_GLOBAL_INT,
        STATUSTEXT,
    }
}
